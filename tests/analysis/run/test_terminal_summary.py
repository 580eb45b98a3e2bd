"""The summary that a run prints at its end."""

import pytest

from analysis.run.terminal_summary import print_summary


def test_brackets_in_texts_of_autopilots_and_users_are_printed(
    capsys: pytest.CaptureFixture[str],
) -> None:
    text = "last output of PX4: ERROR [px4] Startup script returned [/etc/init.d-posix/rcS]"
    fault = {
        "id": "bias[0]", "target": "ATTITUDE.roll", "start_s": 1.0, "end_s": None, "frames": 3,
        "delay_s": None, "isolated": (), "verdict": "missed", "reason": "", "wrongly": (),
    }  # fmt: skip
    criterion = {"name": "flight completed", "value": text, "limit": "landed", "passed": False}
    summary = {
        "faults": [fault], "never_acted": ["jump[1]"], "edited": ["bias[0] was cleared"],
        "attitude_rmse_deg": None, "position_rmse_m": None, "epochs": 0, "untestable_epochs": 0,
        "alarms": 0, "false_alarms": 0, "watched": (), "untestable_reasons": {},
        "epochs_without_imu": 0, "unbounded_epochs": 0, "false_by_channel": (), "sim_s": 1.0,
        "wall_s": 1.0, "criteria": [criterion], "verdict": "FAIL",
    }  # fmt: skip
    print_summary(summary, None)
    printed = capsys.readouterr().out
    assert "unexplained" not in printed
    for expected in (
        f"{text} (limit landed) FAILED",
        "bias[0]  ",
        "fault jump[1] matched no message",
        "verdict  ",
    ):
        assert expected in printed
    assert printed.endswith(" FAIL\n")


def test_a_pass_with_unexplained_epochs_has_a_line_about_them(
    capsys: pytest.CaptureFixture[str],
) -> None:
    summary = {
        "faults": [], "attitude_rmse_deg": None, "position_rmse_m": None, "epochs": 120,
        "untestable_epochs": 0, "unexplained_epochs": 1, "alarms": 1, "false_alarms": None,
        "watched": ("satellites",), "untestable_reasons": {}, "epochs_without_imu": 0,
        "unbounded_epochs": 0, "false_by_channel": None, "sim_s": 120.0, "wall_s": 1.0,
        "criteria": [], "verdict": "PASS",
        "unexplained_reasons": {"more satellites contradict": 1},
    }  # fmt: skip
    print_summary(summary, None)
    assert "unexplained     1 of 120 epochs: more satellites contradict" in capsys.readouterr().out

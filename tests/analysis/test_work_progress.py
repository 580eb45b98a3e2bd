import pytest

from analysis.work_progress import WorkProgress


def test_off_a_terminal_each_tenth_has_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    with WorkProgress("searching", 50, "tests") as progress:
        progress._next_s = -1e9
        for done in range(0, 51, 5):
            progress.show(done, "worst 3")
            progress._next_s = -1e9  # as if time had passed
        progress.say("a [line]")
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "searching 5 of 50 tests  worst 3"
    assert lines[-2:] == ["searching 50 of 50 tests  worst 3", "a [line]"]
    assert len(lines) == 11


def test_seconds_of_flight_have_a_speed_and_the_end_is_always_shown(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with WorkProgress("flying", 120.0) as progress:
        progress.show(60.0, "no fault")
        progress.show(61.0)  # too soon after the last
        progress.show(120.0, "gyro-step")
    first, last = capsys.readouterr().err.splitlines()
    assert first.startswith("flying   60.0 s  x")
    assert last.endswith("gyro-step")

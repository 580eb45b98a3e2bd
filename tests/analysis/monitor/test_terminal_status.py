"""The live table: newest verdicts, and which of them are old."""

import pytest
from rich.console import Console

from analysis.monitor.terminal_status import TerminalStatus
from analysis.results import AttitudeError, Result, SensorDecision


def alarm(t_s: float) -> SensorDecision:
    return SensorDecision(
        t_us=round(t_s * 1e6), sensor="mag", statistic=None, threshold=None, dof=0, alarm=True,
        reason="silent",
    )  # fmt: skip


def attitude(t_s: float) -> AttitudeError:
    return AttitudeError(
        t_us=round(t_s * 1e6), estimator="ekf", roll=0.0, pitch=0.0, yaw=0.0, angle=1.0
    )


@pytest.mark.parametrize(("later_s", "old"), [(2.0, False), (9.0, True)])
def test_a_verdict_that_is_not_repeated_is_shown_as_old(later_s: float, old: bool) -> None:
    watch = TerminalStatus()
    results: list[Result] = [alarm(10.0), attitude(10.0 + later_s)]
    watch.show(results)
    console = Console(width=120, record=True)
    console.print(watch._table(later_s))
    text = console.export_text()
    assert "mag" in text
    assert ("9 s ago" in text) is old

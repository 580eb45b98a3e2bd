"""A compact live status on the terminal: the newest verdict of every detector."""

import time

from rich.console import Console
from rich.live import Live
from rich.table import Table
from rich.text import Text

from analysis.results import AttitudeError, Decision, FusedState, Result, SensorDecision

REDRAW_S = 0.2  # readable, and cheap beside the monitor
# age of an outdated verdict: some detectors report alarms only, and nothing when they end
OLD_S = 3.0


class TerminalStatus:
    """Redraws a small table a few times a second; into a pipe it prints changes.

    Seconds count from the first result.
    """

    def __init__(self) -> None:
        self._console = Console(markup=False)
        self._rows: dict[str, tuple[str, str, str]] = {}
        self._reported_s: dict[str, float] = {}
        # Redrawn explicitly: a thread of its own would cost more than the table.
        self._live = Live(console=self._console, auto_refresh=False)
        self._drawn_s = 0.0
        self._begin_s: float | None = None

    def __enter__(self) -> "TerminalStatus":
        if self._console.is_terminal:
            self._live.start()
        return self

    def __exit__(self, *raised: object) -> None:
        self._live.stop()

    def show(self, results: list[Result]) -> None:
        """Add results and redraw when it is due."""
        for result in results:
            name, row = _status_row(result)
            if self._begin_s is None:
                self._begin_s = result.t_s
            since_s = result.t_s - self._begin_s
            # Into a pipe only changes of the verdict are printed.
            previous = self._rows.get(name)
            self._rows[name], self._reported_s[name] = row, since_s
            if not self._console.is_terminal and (previous is None or previous[1] != row[1]):
                self._console.print(f"{since_s:9.1f} s  {name:<14} {row[1]} {row[2]}")
        now_s = time.monotonic()
        if results and self._console.is_terminal and now_s - self._drawn_s > REDRAW_S:
            self._drawn_s = now_s
            self._live.update(self._table(since_s), refresh=True)

    def _table(self, t_s: float) -> Table:
        table = Table("source", "value", "verdict", "", box=None, title=f"{t_s:.1f} s")
        for name, (value, verdict, remark) in self._rows.items():
            old_s = t_s - self._reported_s[name]
            colour = "green" if verdict in ("healthy", "none", "") else "red"
            if old_s > OLD_S:
                colour, remark = "dim", f"{remark} ({old_s:.0f} s ago)".lstrip()
            table.add_row(name, value, Text(verdict, colour), remark)
        return table


def _status_row(result: Result) -> tuple[str, tuple[str, str, str]]:
    """Name, and value, verdict and remark of a result."""
    match result:
        case Decision():
            return "satellites", (
                _ratio(result.statistic, result.threshold),
                result.hypothesis,
                " ".join(result.excluded) or result.reason,
            )
        case SensorDecision():
            verdict = "isolated" if result.isolated else "alarm" if result.alarm else "healthy"
            return result.sensor, (
                _ratio(result.statistic, result.threshold),
                verdict,
                result.reason,
            )
        case AttitudeError():
            return f"attitude {result.estimator}", (f"{result.angle:.2f} deg", "", "")
        case FusedState():
            sigma = max(result.position_sigma_m)
            return "fusion", (f"sigma {sigma:.2f} m", "", result.reason)


def _ratio(statistic: float | None, threshold: float | None) -> str:
    if statistic is None or threshold is None:
        return "-"
    return f"{statistic:.1f} / {threshold:.1f}"

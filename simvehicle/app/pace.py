"""The pace of simulated time: real time, N times real time, or as fast as possible."""

import math

from mavproxy_fault.documents.errors import ConfigError

LARGEST_LAG_S = 0.5  # a larger lag is dropped, as catching it up would flood the peers


def parse_speed(text: str) -> float:
    """Multiple of real time in a `--speed` argument; `max` is infinite.

    Raises
    ------
    ConfigError
        If the text is neither a positive number nor `max`.
    """
    if text == "max":
        return math.inf
    try:
        speed = float(text)
    except ValueError:
        speed = math.nan
    if not 0.0 < speed < math.inf:
        raise ConfigError(f"--speed: {text} is not a speed; use a number above 0, or max")
    return speed


class Pace:
    """Schedules the steps; wall time is passed in as seconds of any monotonic clock."""

    def __init__(self, speed: float) -> None:
        self.speed = speed
        self._start: tuple[float, int] | None = None

    def late_s(self, t_us: int, now_s: float) -> float:
        """Seconds by which the step after the one at `t_us` is overdue; 0 before the first."""
        return max(-self._ahead_s(t_us, now_s), 0.0)

    def wait_s(self, t_us: int, now_s: float) -> float:
        """Seconds to wait before the step at `t_us`; 0 when it is due."""
        ahead_s = self._ahead_s(t_us, now_s)
        # Restart the count: catching up after a long pause would flood the peers.
        if self._start is None or ahead_s < -LARGEST_LAG_S:
            self._start = (now_s, t_us)
        return max(ahead_s, 0.0)

    def _ahead_s(self, t_us: int, now_s: float) -> float:
        if self._start is None or math.isinf(self.speed):  # at full speed every step is due
            return 0.0
        wall_s, from_us = self._start
        return (t_us - from_us) * 1e-6 / self.speed - (now_s - wall_s)

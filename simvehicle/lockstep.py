"""Lockstep with an autopilot on the HIL link: when the next step may be taken; no I/O, no clock.

PX4 answers every HIL_SENSOR of id 0 by HIL_ACTUATOR_CONTROLS with the same `time_usec`, but only
after it has started up (1.1 to 3 s of simulated time). So until the first answer the simulator
goes on at real time, and from then on it waits for each answer, for a while: a lost frame must not
hold the flight for ever.
"""

ANSWER_TIMEOUT_S = 2.0  # wall time; PX4 needs a millisecond, a debugger much longer
MOST_TIMEOUTS = 5  # in a row, before the autopilot counts as gone


class Lockstep:
    """What was sent and what was answered.

    Attributes
    ----------
    answered : bool
        The autopilot has answered at least once: from now on the simulator waits for it.
    timeouts : int
        Steps in a row that were taken without an answer.
    """

    def __init__(self, timeout_s: float = ANSWER_TIMEOUT_S) -> None:
        self.answered = False
        self.timeouts = 0
        self._timeout_s = timeout_s
        self._stamp_us: int | None = None
        self._sent_s = 0.0

    def sent(self, stamp_us: int, now_s: float) -> None:
        """A HIL_SENSOR with this stamp has left."""
        self._stamp_us = stamp_us
        self._sent_s = now_s

    def received(self, stamp_us: int) -> None:
        """An answer with this stamp has come; one to an earlier step does not count."""
        self.answered = True
        if stamp_us == self._stamp_us:
            self._stamp_us = None
            self.timeouts = 0

    def wait_s(self, now_s: float) -> float:
        """How long to wait for the answer at most; 0 when the next step may be taken.

        Raises
        ------
        AutopilotSilentError
            When too many steps in a row had no answer.
        """
        if not self.answered or self._stamp_us is None:
            return 0.0
        left_s = self._sent_s + self._timeout_s - now_s
        if left_s > 0:
            return left_s
        self._stamp_us = None
        self.timeouts += 1
        if self.timeouts >= MOST_TIMEOUTS:
            raise AutopilotSilentError(
                f"the autopilot has not answered {self.timeouts} steps in a row, "
                f"waiting {self._timeout_s:g} s for each"
            )
        return 0.0


class AutopilotSilentError(RuntimeError):
    """The autopilot stopped answering."""

"""Lockstep with an autopilot on the HIL link: decides when to take the next step; no I/O, no clock.

PX4 answers every HIL_SENSOR of id 0 by HIL_ACTUATOR_CONTROLS with the same `time_usec`, but only
after it has started up (1.1 to 3 s of simulated time). So until the first answer the simulator
runs in real time, and from then on it waits for each answer.

The wait has a timeout, as a frame may be lost or delayed on the way (a proxy may do so on purpose).
After a timeout the simulator runs in real time again until the answers keep up.
"""

ANSWER_TIMEOUT_S = 2.0  # wall time; PX4 needs a millisecond, a debugger much longer
RELOCK_S = 5.0  # after a timeout, until answers to earlier steps restore lockstep; chosen
SILENCE_TIMEOUT_S = 30.0  # without any answer, until the autopilot counts as lost; chosen


class Lockstep:
    """The last step sent and the last answer; times are seconds of any monotonic clock.

    Attributes
    ----------
    locked : bool
        Steps wait for their answers.
    answered : bool
        The autopilot has answered at least once.
    """

    def __init__(
        self, timeout_s: float = ANSWER_TIMEOUT_S, silence_s: float = SILENCE_TIMEOUT_S
    ) -> None:
        self.locked = False
        self.answered = False
        self._timeout_s = timeout_s
        self._silence_s = silence_s
        self._stamp_us: int | None = None
        self._sent_s = 0.0
        self._heard_s = 0.0
        self._unlocked_s: float | None = None  # time of the last timeout

    def sent(self, stamp_us: int | None, now_s: float) -> None:
        """Record that a HIL_SENSOR was sent; `stamp_us` is None if a fault withheld it."""
        self._stamp_us = stamp_us
        self._sent_s = now_s

    def received(self, stamp_us: int, now_s: float) -> None:
        """Record an answer; only the answer to the last step permits the next one."""
        self.answered = True
        self._heard_s = now_s
        current = stamp_us == self._stamp_us
        if current:
            self._stamp_us = None
        if current or self._unlocked_s is None or now_s - self._unlocked_s > RELOCK_S:
            self.locked = True

    def wait_s(self, now_s: float) -> float:
        """Seconds to wait for the answer at most; 0 when the next step may be taken.

        A timeout suspends lockstep.

        Raises
        ------
        AutopilotSilentError
            If there was no answer for `silence_s`.
        """
        if self.answered and now_s - self._heard_s > self._silence_s:
            raise AutopilotSilentError(f"the autopilot has not answered for {self._silence_s:g} s")
        if not self.locked or self._stamp_us is None:
            return 0.0
        remaining_s = self._sent_s + self._timeout_s - now_s
        if remaining_s > 0:
            return remaining_s
        self.locked = False
        self._unlocked_s = now_s
        return 0.0


class AutopilotSilentError(RuntimeError):
    """The autopilot stopped answering."""

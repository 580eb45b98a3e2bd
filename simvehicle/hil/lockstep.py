"""Lockstep with an autopilot on the HIL link: when the next step may be taken; no I/O, no clock.

PX4 answers every HIL_SENSOR of id 0 by HIL_ACTUATOR_CONTROLS with the same `time_usec`, but only
after it has started up (1.1 to 3 s of simulated time). So until the first answer the simulator
goes on at real time, and from then on it waits for each answer.

It waits for a while only, as a frame may be lost or held back on the way (a proxy may do so on
purpose). After a time-out it goes on at real time again until answers keep up.
"""

ANSWER_TIMEOUT_S = 2.0  # wall time; PX4 needs a millisecond, a debugger much longer
RELOCK_S = 5.0  # after a time-out, before answers to earlier steps are reason enough to wait again
SILENCE_TIMEOUT_S = 30.0  # without any answer, after which the autopilot counts as gone


class Lockstep:
    """What was sent and what was answered; times are seconds of any steady clock.

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
        self._unlocked_s: float | None = None  # when the last time-out was

    def sent(self, stamp_us: int | None, now_s: float) -> None:
        """A HIL_SENSOR with this stamp has left; None where a fault withheld it from the step."""
        self._stamp_us = stamp_us
        self._sent_s = now_s

    def received(self, stamp_us: int, now_s: float) -> None:
        """An answer with this stamp has come; only that to the last step frees the next one."""
        self.answered = True
        self._heard_s = now_s
        current = stamp_us == self._stamp_us
        if current:
            self._stamp_us = None
        if current or self._unlocked_s is None or now_s - self._unlocked_s > RELOCK_S:
            self.locked = True

    def wait_s(self, now_s: float) -> float:
        """How long to wait for the answer at most; 0 when the next step may be taken.

        A wait that is over without an answer ends the lockstep for the time being.

        Raises
        ------
        AutopilotSilentError
            When there was no answer at all for long.
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

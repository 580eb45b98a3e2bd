import pytest

from simvehicle.lockstep import AutopilotSilentError, Lockstep


def test_until_the_first_answer_nothing_is_waited_for() -> None:
    lockstep = Lockstep()
    lockstep.sent(1_000_000, 0.0)
    assert lockstep.wait_s(0.0) == 0.0


def test_after_the_first_answer_each_step_is_waited_for() -> None:
    lockstep = Lockstep(timeout_s=2.0)
    lockstep.received(1_000_000)
    lockstep.sent(1_004_000, 10.0)
    assert lockstep.wait_s(10.5) == pytest.approx(1.5)
    lockstep.received(1_004_000)
    assert lockstep.wait_s(10.5) == 0.0


def test_an_answer_to_an_earlier_step_does_not_free_this_one() -> None:
    lockstep = Lockstep()
    lockstep.received(1_000_000)
    lockstep.sent(1_004_000, 0.0)
    lockstep.received(1_000_000)
    assert lockstep.wait_s(0.0) > 0.0


def test_a_lost_answer_holds_the_flight_for_the_time_out_only() -> None:
    lockstep = Lockstep(timeout_s=2.0)
    lockstep.received(1_000_000)
    lockstep.sent(1_004_000, 0.0)
    assert lockstep.wait_s(2.0) == 0.0
    assert lockstep.timeouts == 1
    lockstep.sent(1_008_000, 2.0)
    lockstep.received(1_008_000)
    assert lockstep.timeouts == 0


def test_an_autopilot_that_never_answers_again_is_an_error() -> None:
    lockstep = Lockstep(timeout_s=2.0)
    lockstep.received(1_000_000)

    def run() -> None:
        for step in range(10):
            lockstep.sent(1_004_000 + step, 2.0 * step)
            lockstep.wait_s(2.0 * (step + 1))

    with pytest.raises(AutopilotSilentError, match="5 steps in a row, waiting 2 s"):
        run()

import pytest

from simvehicle.hil.lockstep import AutopilotSilentError, Lockstep


def locked(timeout_s: float = 2.0) -> Lockstep:
    """In lockstep, with a step sent at 10 s."""
    lockstep = Lockstep(timeout_s=timeout_s, silence_s=30.0)
    lockstep.sent(1_000_000, 9.0)
    lockstep.received(1_000_000, 9.5)
    lockstep.sent(1_004_000, 10.0)
    return lockstep


def test_until_the_first_answer_no_step_waits() -> None:
    lockstep = Lockstep()
    lockstep.sent(1_000_000, 0.0)
    assert lockstep.wait_s(100.0) == 0.0


def test_the_first_answer_starts_the_lockstep_even_if_it_comes_late() -> None:
    lockstep = Lockstep()
    lockstep.sent(1_004_000, 0.0)
    lockstep.received(1_000_000, 0.0)
    assert lockstep.wait_s(0.5) == pytest.approx(1.5)


def test_each_step_waits_for_its_answer() -> None:
    lockstep = locked()
    assert lockstep.wait_s(10.5) == pytest.approx(1.5)
    lockstep.received(1_004_000, 10.5)
    assert lockstep.wait_s(10.5) == 0.0


def test_an_answer_to_an_earlier_step_does_not_permit_the_next() -> None:
    lockstep = locked()
    lockstep.received(1_000_000, 10.0)
    assert lockstep.wait_s(10.0) > 0.0


def test_after_a_timeout_no_step_waits_until_answers_keep_up() -> None:
    lockstep = locked()
    assert lockstep.wait_s(12.0) == 0.0
    assert not lockstep.locked
    lockstep.sent(1_008_000, 12.0)
    lockstep.received(1_004_000, 12.0)  # delayed on the way
    assert lockstep.wait_s(12.0) == 0.0
    lockstep.received(1_008_000, 12.1)
    lockstep.sent(1_012_000, 12.2)
    assert lockstep.wait_s(12.2) == pytest.approx(2.0)


def test_an_autopilot_that_stays_behind_is_in_lockstep_again_after_a_while() -> None:
    lockstep = locked()
    lockstep.wait_s(12.0)
    lockstep.sent(1_008_000, 17.5)
    lockstep.received(1_004_000, 17.5)
    assert lockstep.wait_s(17.5) == pytest.approx(2.0)


def test_an_autopilot_that_never_answers_again_is_an_error() -> None:
    lockstep = locked()
    assert lockstep.wait_s(39.0) == 0.0
    with pytest.raises(AutopilotSilentError, match="has not answered for 30 s"):
        lockstep.wait_s(40.0)

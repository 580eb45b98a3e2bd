"""Acquisition, loss and reacquisition of signals, and reading of ephemerides."""

import numpy as np
import pytest

from simvehicle.gnss.gnss_config import ReceiverConfig
from simvehicle.gnss.tracking import Tracking, powered_off_tracking, update_tracking

RECEIVER = ReceiverConfig(reacquire_s=2.0)
SEARCH_S = np.array([1.0, 5.0])
MESSAGE_S = np.array([20.0, 30.0])
S = 1_000_000


def run(start: Tracking, signals: dict[int, tuple[bool, bool]], until_s: int) -> dict[int, str]:
    """Per second and satellite, t for tracked and u for usable; signals change at their time."""
    seen, signal, tracking = {}, (True, True), start
    for second in range(until_s + 1):
        signal = signals.get(second, signal)
        tracking = update_tracking(
            tracking, np.array(signal), second * S, RECEIVER, SEARCH_S, MESSAGE_S
        )
        seen[second] = "".join(
            "u" if usable else "t" if tracked else "-"
            for tracked, usable in zip(
                tracking.tracked(second * S), tracking.usable(second * S), strict=True
            )
        )
    return seen


def first(seen: dict[int, str], satellite: int, letters: str) -> int:
    return next(second for second, text in seen.items() if text[satellite] in letters)


def test_after_a_hot_start_everything_is_usable_at_once() -> None:
    assert run(powered_off_tracking(2, cold=False), {}, 0) == {0: "uu"}


def test_after_a_cold_start_signals_come_first_and_messages_later() -> None:
    seen = run(powered_off_tracking(2, cold=True), {}, 40)
    assert [first(seen, k, "tu") for k in (0, 1)] == [1, 5]
    assert [first(seen, k, "u") for k in (0, 1)] == [21, 35]


def test_a_lost_signal_is_reacquired_after_its_return() -> None:
    seen = run(powered_off_tracking(2, cold=False), {10: (False, True), 15: (True, True)}, 20)
    assert [seen[s] for s in (9, 10, 15, 16, 17)] == ["uu", "-u", "-u", "-u", "uu"]


def test_an_interrupted_message_is_read_from_its_start_and_then_kept() -> None:
    signals = {10: (False, True), 11: (True, True), 40: (False, True), 41: (True, True)}
    seen = run(powered_off_tracking(2, cold=True), signals, 45)
    assert seen[13][0] == "t"
    assert first(seen, 0, "u") == 11 + 2 + 20
    assert [seen[s][0] for s in (39, 40, 42, 43)] == ["u", "-", "-", "u"]


def test_a_satellite_that_rises_later_is_found_after_the_shorter_time() -> None:
    seen = run(powered_off_tracking(2, cold=False), {0: (True, False), 8: (True, True)}, 12)
    assert first(seen, 1, "u") == 10


@pytest.mark.parametrize("cold", [True, False])
def test_without_power_nothing_is_tracked(cold: bool) -> None:
    off = powered_off_tracking(2, cold)
    assert not off.tracked(10**12).any()
    assert not off.usable(10**12).any()

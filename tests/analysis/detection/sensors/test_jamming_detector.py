"""Signals that fall together, on epochs that are made and on a recording that is jammed."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from analysis.detection.sensors.jamming_detector import JammingDetector, common_loss_db
from analysis.recordings.read_recordings import read_rinex
from analysis.results import SensorDecision
from analysis.samples.block import Block, block_of
from analysis.samples.sample import Epoch
from mavproxy_fault.app.replaying.rinex_faults import faulted_lines
from mavproxy_fault.schedule.entries import parse_schedule

SATELLITES = tuple(f"G{n:02d}" for n in range(1, 9))
BEGIN_S, END_S = 100.0, 130.0
Fall = Callable[[float], np.ndarray]


def alarms(block: Block) -> list[SensorDecision]:
    detector = JammingDetector()
    return [result for _, result in detector.step(block, detector.new_state())[0]]


def sky(fall_db: Fall, step_s: float = 1.0, until_s: float = 160.0) -> Block:
    """Epochs with a decibel of noise, whose signals are weaker by `fall_db` from BEGIN_S to END_S;
    by NaN they vanish."""
    rng = np.random.default_rng(3)
    strong = rng.uniform(33.0, 50.0, len(SATELLITES))
    epochs = []
    for t_s in np.arange(0.0, until_s, step_s):
        weaker = fall_db(t_s - BEGIN_S) if BEGIN_S <= t_s < END_S else np.zeros(len(SATELLITES))
        cn0_dbhz = strong + rng.normal(0.0, 1.0, len(SATELLITES)) - weaker
        seen = np.flatnonzero(np.isfinite(cn0_dbhz))
        names = tuple(SATELLITES[i] for i in seen)
        unknown = np.full(len(seen), np.nan)
        epochs.append(Epoch(round(t_s * 1e6), 2300, t_s, names, unknown, unknown, cn0_dbhz[seen]))
    return block_of(epochs)


def everybody(loss_db: float) -> Fall:
    return lambda _: np.full(len(SATELLITES), loss_db)


@pytest.mark.parametrize("step_s", [0.1, 0.2, 1.0, 5.0])
@pytest.mark.parametrize(
    "fall", [everybody(10.0), everybody(25.0), lambda t_s: np.full(len(SATELLITES), 1.0 * t_s)]
)
def test_a_jammer_raises_alarms_while_it_lasts(fall: Fall, step_s: float) -> None:
    found = alarms(sky(fall, step_s))
    assert {(result.sensor, result.suspect) for result in found} == {("satellites", "")}
    assert all("jamming" in result.reason for result in found)
    # A jammer that comes nearer by a decibel a second has taken 10 dB by then.
    assert BEGIN_S <= found[0].t_s <= BEGIN_S + 8.0 + 3.0 * step_s
    assert END_S - 1.0 - step_s <= found[-1].t_s < END_S


def test_vanished_signals_are_reported_without_a_cause() -> None:
    vanished = alarms(sky(lambda _: np.array([np.nan] * 6 + [20.0, 20.0])))
    assert {result.reason for result in vanished} == {"most signals are lost"}


def test_a_jammer_near_enough_to_erase_signals_is_one_event() -> None:
    def fall(t_s: float) -> np.ndarray:
        return np.full(len(SATELLITES), np.nan if t_s > 20.0 else t_s)

    found = alarms(sky(fall))
    gaps_s = np.diff([result.t_s for result in found])
    assert gaps_s.max() == 1.0
    assert found[-1].t_s == END_S - 1.0


@pytest.mark.parametrize(
    "fall",
    [
        everybody(0.0),
        everybody(4.0),
        # A wall takes one half of the sky, a tree different amounts from all.
        lambda _: np.where(np.arange(len(SATELLITES)) < 4, 15.0, 0.0),
        lambda _: np.array([0.0, 0.0, 1.0, 2.0, 7.0, 9.0, 12.0, 20.0]),
        lambda _: np.array([np.nan] * 3 + [0.0] * 5),
        # A bridge over the road.
        lambda _: np.array([3.0, 5.0, 5.0, 7.0, 7.0, 9.0, 12.0, 13.0]),
    ],
)
def test_weaker_signals_of_some_satellites_are_no_jammer(fall: Fall) -> None:
    assert alarms(sky(fall)) == []


def test_a_jammer_of_one_band_leaves_the_others_as_they_are() -> None:
    names = (*SATELLITES, *(f"R{n:02d}" for n in range(1, 9)))
    carriers = np.array([1575.42e6] * 8 + [1602.0e6 + 562_500.0 * k for k in range(-4, 4)])

    def epoch(t_s: float) -> Epoch:
        strong = np.full(16, 45.0)
        strong[:8] -= 15.0 if BEGIN_S <= t_s < END_S else 0.0
        return Epoch(
            round(t_s * 1e6), 2300, t_s, names, *np.full((2, 16), np.nan), strong, carriers
        )

    assert alarms(block_of(epoch(t_s) for t_s in np.arange(0.0, 160.0)))[0].t_s == BEGIN_S + 2.0


def test_few_satellites_are_not_tested() -> None:
    assert common_loss_db([20.0, 20.0, 20.0]) == 0.0


def test_weak_signals_become_usual_after_a_while() -> None:
    detector = JammingDetector()
    weak = block_of(
        Epoch(
            round(t_s * 1e6), 2300, t_s, SATELLITES, *np.full((2, 8), np.nan),
            np.full(8, 45.0 if t_s < 50.0 else 25.0),
        )
        for t_s in np.arange(0.0, 500.0)
    )  # fmt: skip
    found, _ = detector.step(weak, detector.new_state())
    assert 340.0 < found[-1][1].t_s < 360.0


def test_the_cut_into_blocks_changes_nothing() -> None:
    whole, detector = sky(everybody(10.0)), JammingDetector()
    state, one_by_one = detector.new_state(), []
    for row in range(len(whole.kind)):
        found, state = detector.step(whole.between(row, row + 1), state)
        one_by_one += [result for _, result in found]
    assert one_by_one == alarms(whole)


def test_a_jammed_recording_raises_an_alarm_and_a_clean_one_does_not(shared_data: Path) -> None:
    folder = shared_data / "gnss_static"
    obs, nav = folder / "SEPT078M.21O", folder / "SEPT078M.21P"
    assert alarms(read_rinex(obs, nav)) == []
    jammer = {"preset": "gnss-jamming-growing", "at_s": 100, "for_s": 60}
    lines, _ = faulted_lines(obs, parse_schedule({"faults": [jammer]}), [nav])
    block = read_rinex(obs, nav, None, lines)
    found = alarms(block)
    first_us = min(sample.t_us for sample in block.samples() if isinstance(sample, Epoch))
    assert 100.0 < (found[0].t_us - first_us) * 1e-6 <= 110.0

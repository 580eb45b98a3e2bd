"""Link faults: number, delay and order of frames."""

import itertools
import math
from typing import Any

import numpy as np
import pytest

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.schedule.entries import parse_schedule
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame

LAYOUT = message_layout("HIL_SENSOR")
STEP_US = 10_000


def run(fault: dict[str, Any], count: int) -> list[tuple[int, int, Any]]:
    """Return (frame number, delay in us, frame or bytes) of all output."""
    engine = Engine(parse_schedule({"seed": 11, "faults": [fault]}))
    found = []
    for i in range(count):
        values = {"time_usec": 1_000_000 + i * STEP_US, "zacc": -9.81, "id": 1}
        frame = Frame(build_frame(LAYOUT, values, seq=i % 256, component=51), LAYOUT)
        t_us = 1_000_000 + i * STEP_US
        found += [(i, o.due_us - t_us, o.frame) for o in engine.apply(frame, "to-vehicle", t_us)]
    return found


def test_a_fraction_of_the_frames_is_lost() -> None:
    left = len(run({"fault": "drop", "value": 0.3}, 4000))
    assert abs(left - 2800) < 4 * math.sqrt(4000 * 0.3 * 0.7)


def test_losses_of_a_bad_channel_come_in_clusters_of_their_mean_length() -> None:
    fault = {"fault": "gilbert-elliott", "to_bad": 0.02, "to_good": 0.2}
    left = {i for i, _, _ in run(fault, 20_000)}
    lost = [i for i in range(20_000) if i not in left]
    clusters = sum(i - 1 in left for i in lost)
    # the bad state lasts 1 / 0.2 frames on average, and 0.02 / 0.22 of the time
    assert len(lost) / clusters == pytest.approx(5, rel=4 / math.sqrt(clusters))
    assert len(lost) / 20_000 == pytest.approx(0.02 / 0.22, rel=0.3)


def test_four_states_lose_their_share_in_bursts_of_their_length() -> None:
    keys = {"p13": 0.03, "p31": 0.1, "p32": 0.2, "p23": 0.4, "p14": 0.01}
    count = 40_000
    passed = np.zeros(count, bool)
    passed[[i for i, _, _ in run({"fault": "four-state-loss", **keys}, count)]] = True
    chain = np.array([
        [0.96, 0, 0.03, 0.01], [0, 0.6, 0.4, 0], [0.1, 0.2, 0.7, 0], [1, 0, 0, 0],
    ])  # fmt: skip
    steady = np.linalg.matrix_power(chain, 10_000)[0]
    # A loss is followed by another one only within a burst.
    again = steady[2] * 0.7 / (steady[2] + steady[3])
    lost = ~passed
    assert lost.mean() == pytest.approx(steady[2:].sum(), rel=0.06)
    assert (lost[1:] & lost[:-1]).sum() / lost.sum() == pytest.approx(again, rel=0.04)
    with pytest.raises(ConfigError, match="must not exceed 1"):
        run({"fault": "four-state-loss", "p13": 0.6, "p14": 0.5}, 1)


def test_a_burst_drops_its_number_of_frames() -> None:
    left = {i for i, _, _ in run({"fault": "burst-loss", "value": 0.01, "frames": 7}, 2000)}
    lost = [i for i in range(2000) if i not in left]
    runs = [i for i in lost if i - 1 in left]
    assert runs
    assert all(set(range(i, min(i + 7, 2000))).isdisjoint(left) for i in runs)


def test_a_delay_is_exact() -> None:
    assert {late for _, late, _ in run({"fault": "delay", "value": 0.0125}, 50)} == {12_500}


@pytest.mark.parametrize("kind", ["uniform", "normal", "exponential", "pareto"])
def test_jitter_keeps_the_order_by_default(kind: str) -> None:
    fault = {"fault": "jitter", "value": 0.05, "distribution": kind, "base_s": 0.01}
    due = [i * STEP_US + late for i, late, _ in run(fault, 400)]
    assert due == sorted(due)
    loose = [i * STEP_US + late for i, late, _ in run({**fault, "keep_order": False}, 400)]
    assert loose != sorted(loose)
    # A normal one lies on both sides of its base.
    assert min(late for _, late, _ in run(fault, 400)) >= (0 if kind == "normal" else 10_000)


def test_jitter_has_its_mean() -> None:
    fault = {"fault": "jitter", "value": 0.03, "keep_order": False}
    late = [late for _, late, _ in run(fault, 3000)]
    sigma_us = 30_000 / math.sqrt(12)
    assert sum(late) / 3000 == pytest.approx(15_000, abs=4 * sigma_us / math.sqrt(3000))


def test_reordered_frames_are_overtaken() -> None:
    sent = run({"fault": "reorder", "value": 0.2, "by_s": 0.025}, 200)
    order = [i for i, late, _ in sorted(sent, key=lambda row: row[0] * STEP_US + row[1])]
    assert sorted(order) == list(range(200))
    assert order != sorted(order)


def test_with_a_gap_each_so_many_th_frame_overtakes_the_others() -> None:
    late = [us for _, us, _ in run({"fault": "reorder", "value": 1, "by_s": 0.02, "gap": 5}, 15)]
    assert late == [20_000, 20_000, 20_000, 20_000, 0] * 3
    share = {"fault": "reorder", "value": 0.5, "by_s": 0.02, "gap": 4}
    times = [i for i, us, _ in run(share, 8000) if not us]
    # After three delayed frames the next one leaves at once with a probability of a half.
    assert np.diff(times).min() == 4
    assert np.diff(times).mean() == pytest.approx(5, abs=4 * math.sqrt(2 / len(times)))


def test_reordering_is_correlated_as_asked() -> None:
    fault = {"fault": "reorder", "value": 0.3, "by_s": 0.02, "correlation": 0.6}
    late = [us > 0 for _, us, _ in run(fault, 20_000)]
    assert np.mean(late) == pytest.approx(0.3, abs=0.03)
    assert np.corrcoef(late[1:], late[:-1])[0, 1] == pytest.approx(0.6, abs=0.05)


def test_duplicates_are_the_same_bytes() -> None:
    sent = run({"fault": "duplicate", "copies": 2, "by_s": 0.01}, 5)
    assert [(i, late) for i, late, _ in sent[:3]] == [(0, 0), (0, 5_000), (0, 10_000)]
    assert len({frame.raw for _, _, frame in sent[:3]}) == 1


def test_a_rate_limit_drops_excess_frames() -> None:
    assert len(run({"fault": "rate-limit", "value": 25}, 400)) == 100


def test_a_rate_limit_with_a_queue_delays_instead() -> None:
    sent = run({"fault": "rate-limit", "value": 50, "queue_s": 0.1}, 10)
    assert [late for _, late, _ in sent[:4]] == [0, 10_000, 20_000, 30_000]


def test_corruption_leaves_an_invalid_or_a_valid_crc() -> None:
    ((_, _, broken),) = run({"fault": "corrupt", "count": 2}, 1)
    ((_, _, healthy),) = run({"fault": "delay", "value": 0}, 1)
    assert isinstance(broken, bytes)
    assert sum(a != b for a, b in zip(broken, healthy.raw, strict=True)) == 2
    ((_, _, believed),) = run({"fault": "corrupt", "crc": "redone"}, 1)
    assert isinstance(believed, Frame)
    assert believed.with_payload(believed.payload).raw == believed.raw


def test_truncation_cuts_the_end() -> None:
    ((_, _, cut),) = run({"fault": "truncate", "count": 10}, 1)
    ((_, _, healthy),) = run({"fault": "delay", "value": 0}, 1)
    assert cut == healthy.raw[:-10]


def test_a_sequence_gap_persists() -> None:
    sent = run({"fault": "sequence-gap", "value": 0.05, "count": 3}, 300)
    ahead = [(frame.seq - i) % 256 for i, _, frame in sent]
    assert all((b - a) % 256 in (0, 3) for a, b in itertools.pairwise(ahead))
    assert ahead[-1] > 0


@pytest.mark.parametrize(
    ("fault", "off_us"),
    [
        ({"fault": "time-jump", "value": -0.5}, [-500_000] * 4),
        ({"fault": "time-drift", "value": 0.1}, [0, 1_000, 2_000, 3_000]),
        ({"fault": "time-backwards"}, [0, -20_000, -40_000, -60_000]),
    ],
)
def test_timestamps_are_shifted_and_other_fields_stay(
    fault: dict[str, Any], off_us: list[int]
) -> None:
    sent = run(fault, 4)
    stamps = [f.number("time_usec") - 1_000_000 - i * STEP_US for i, _, f in sent]
    assert stamps == off_us
    assert {round(float(frame.number("zacc")), 2) for _, _, frame in sent} == {-9.81}


def test_timestamps_in_milliseconds_are_shifted_too() -> None:
    engine = Engine(parse_schedule({"faults": [{"fault": "time-jump", "value": 2.5}]}))
    layout = message_layout("ATTITUDE")
    frame = Frame(build_frame(layout, {"time_boot_ms": 1000, "yaw": 1.0}), layout)
    (out,) = engine.apply(frame, "from-vehicle", 1_000_000)
    assert isinstance(out.frame, Frame)
    assert out.frame.number("time_boot_ms") == 3500

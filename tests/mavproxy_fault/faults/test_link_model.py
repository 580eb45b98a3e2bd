"""The link model: rates in bytes, slots, correlation, bit errors, samples and profiles."""

import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.schedule.entries import parse_schedule, read_schedule
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame

LAYOUT = message_layout("FILE_TRANSFER_PROTOCOL")


def frame_of(size: int) -> Frame:
    """A frame of `size` bytes, at least 16."""
    return Frame(build_frame(LAYOUT, {"payload": [255] * (size - 15)}), LAYOUT)


def delays(
    faults: list[dict[str, Any]], times_s: Any, sizes: Any = 100
) -> list[tuple[float, float]]:
    """Arrival and delay [s] of the frames that pass."""
    engine = Engine(parse_schedule({"seed": 5, "faults": faults}))
    engine.start_at(0)
    frames = {int(size): frame_of(int(size)) for size in np.unique(sizes)}
    found = []
    for t_s, size in zip(times_s, np.broadcast_to(sizes, len(times_s)), strict=True):
        t_us = round(t_s * 1e6)
        for out in engine.apply(frames[int(size)], "from-vehicle", t_us):
            found.append((t_us * 1e-6, (out.due_us - t_us) * 1e-6))
    return found


def test_a_frame_of_a_byte_rate_arrives_when_its_last_byte_has_left() -> None:
    limit = {"fault": "rate-limit", "value": 1000, "unit": "bytes", "overhead_bytes": 20}
    # 120 and 60 ms on the line; the third comes later
    late = [late for _, late in delays([limit], [0.0, 0.0, 1.0], [100, 40, 100])]
    assert late == pytest.approx([0.12, 0.18, 0.12])


def test_a_burst_leaves_at_once_after_a_pause() -> None:
    bucket = {"fault": "rate-limit", "value": 1000, "unit": "bytes", "burst_bytes": 250}
    late = [delay for _, delay in delays([bucket], [1.0, 1.0, 1.0, 1.0])]
    assert late == pytest.approx([0.0, 0.0, 0.05, 0.15])


def test_a_queue_of_bytes_takes_whole_frames_while_there_is_room() -> None:
    limit = {"fault": "rate-limit", "value": 1000, "unit": "bytes", "queue_bytes": 350}
    times = [0.0, 0.0, 0.0, 0.0, 0.05, 0.101]
    # the frame on the line still waits as a whole, so there is no room at 0.05 s
    assert [t_s for t_s, _ in delays([limit], times)] == pytest.approx([0.0, 0.0, 0.0, 0.101])


def test_frames_leave_within_their_slots_only() -> None:
    slots = {"fault": "rate-limit", "value": 10_000, "unit": "bytes"}
    slots |= {"period_s": 0.1, "slot_s": 0.03, "queue_s": 10}
    times = np.arange(500) * 0.05
    leaving = [t_s + late for t_s, late in delays([slots], times)]
    assert len(leaving) == 500
    phases = np.array(leaving) % 0.1
    assert np.all((phases < 0.0301) | (phases > 0.0999))
    assert all(b >= a for a, b in pairwise(leaving))
    # two frames of 10 ms in each slot of 30 ms keep up
    assert leaving[-1] - times[-1] < 0.1


def test_a_link_whose_slots_are_too_short_falls_behind_at_its_mean_rate() -> None:
    slots = {"fault": "rate-limit", "value": 10_000, "unit": "bytes", "period_s": 0.1}
    found = delays([{**slots, "slot_s": 0.03, "queue_s": 1e3}], np.zeros(300))
    assert found[-1][1] == pytest.approx(300 * 100 / (10_000 * 0.3), abs=0.1)


def test_the_order_of_a_rate_and_a_delay_is_that_of_the_schedule() -> None:
    """A frame comes to a fault of the link when the one before has let it go."""
    limit = {"fault": "rate-limit", "value": 10, "queue_s": 1}
    slots = {"fault": "rate-limit", "value": 1e6, "period_s": 0.4, "slot_s": 0.1, "queue_s": 1}
    leaving = [t_s + late for t_s, late in delays([limit, slots], [0.0] * 6)]
    assert leaving == pytest.approx([0.0, 0.4, 0.4, 0.4, 0.4, 0.8], abs=1e-4)


@pytest.mark.parametrize("share", [0.02, 0.3])
def test_correlated_losses_keep_their_share_and_have_their_correlation(share: float) -> None:
    count = 40_000
    drop = {"fault": "drop", "value": share, "correlation": 0.6}
    passed = np.zeros(count)
    passed[[round(t_s) for t_s, _ in delays([drop], range(count))]] = 1
    lost = 1 - passed
    # the variance of the mean of a chain with this correlation is (1 + c) / (1 - c) times larger
    sigma = math.sqrt(share * (1 - share) / count * 4)
    assert abs(lost.mean() - share) < 4 * sigma
    assert np.corrcoef(lost[1:], lost[:-1])[0, 1] == pytest.approx(0.6, abs=0.06)


@pytest.mark.parametrize(
    ("name", "mean"), [("uniform", 0.01), ("normal", 0.02 / math.sqrt(2 * math.pi)),
                       ("exponential", 0.02)],
)  # fmt: skip
def test_correlated_delays_keep_their_distribution(name: str, mean: float) -> None:
    jitter = {"fault": "jitter", "value": 0.02, "distribution": name, "keep_order": False}
    late = [late for _, late in delays([{**jitter, "correlation": 0.5}], range(30_000))]
    assert np.mean(late) == pytest.approx(mean, rel=0.05)
    assert np.corrcoef(late[1:], late[:-1])[0, 1] == pytest.approx(0.5, abs=0.05)


def test_bit_errors_lose_long_frames_more_often() -> None:
    count, rate = 20_000, 2e-4
    sizes = np.resize([40, 200], 2 * count)
    left = [round(t_s) for t_s, _ in delays([{"fault": "bit-errors", "value": rate}],
                                            range(2 * count), sizes)]  # fmt: skip
    for parity, size in enumerate((40, 200)):
        expected = (1 - rate) ** (8 * size)
        got = sum(n % 2 == parity for n in left) / count
        assert abs(got - expected) < 4 * math.sqrt(expected * (1 - expected) / count)


def test_delays_are_drawn_from_a_file_beside_the_schedule(tmp_path: Path) -> None:
    recorded = np.random.default_rng(0).gamma(2.0, 0.02, 5000)
    (tmp_path / "rtt.txt").write_text("\n".join(f"{one:.6f}" for one in recorded))
    (tmp_path / "s.yaml").write_text(
        "faults: [{fault: jitter, value: 1, distribution: samples, file: rtt.txt}]"
    )
    entry = read_schedule(tmp_path / "s.yaml").faults[0].written
    samples = np.quantile(recorded, np.linspace(0, 1, 256))
    jitter = {**entry, "samples": [float(one) for one in samples], "keep_order": False}
    del jitter["file"]
    late = [late for _, late in delays([jitter], range(20_000))]
    for share in (0.1, 0.5, 0.9, 0.99):
        assert np.quantile(late, share) == pytest.approx(np.quantile(recorded, share), rel=0.05)
    (tmp_path / "rtt.txt").write_text("0.1 fast")
    with pytest.raises(ConfigError, match="a delay in seconds on each line"):
        read_schedule(tmp_path / "s.yaml")


def test_a_growing_delay_and_loss_follow_their_profiles() -> None:
    ramp = {"segments": [{"at_s": 0, "for_s": 10, "start": 0.1, "rate": 0.05}]}
    late = [late for _, late in delays([{"fault": "delay", "profile": ramp}], [0, 4, 10, 11])]
    assert late == pytest.approx([0.1, 0.3, 0.6, 0.0])
    fall = {"segments": [{"at_s": 0, "for_s": 1, "start": 1}, {"at_s": 1, "for_s": 9, "start": 0}]}
    entry = {"fault": "delay", "profile": fall, "keep_order": True}
    late = [late for _, late in delays([entry], [0.9, 1.1, 2.0])]
    assert late == pytest.approx([1.0, 0.8, 0.0])
    growing = {"segments": [{"at_s": 0, "for_s": 20_000, "start": 0, "rate": 1 / 20_000}]}
    left = [t_s for t_s, _ in delays([{"fault": "drop", "profile": growing}], range(20_000))]
    assert len(left) == pytest.approx(10_000, abs=300)
    assert sum(t_s > 15_000 for t_s in left) == pytest.approx(625, abs=100)  # 20,000 / 32


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ({"fault": "rate-limit", "value": 9, "queue_bytes": 9}, "need `unit: bytes`"),
        ({"fault": "rate-limit", "value": 9, "period_s": 1}, "both period_s and slot_s"),
        ({"fault": "delay"}, "exactly one of value and profile"),
        ({"fault": "jitter", "value": 1, "distribution": "samples"}, "two or more samples"),
        (
            {"fault": "drop", "target": "PSEUDORANGE.G12", "correlation": 0.5},
            "remove profile and correlation",
        ),
    ],
)
def test_what_does_not_fit_together_is_refused(entry: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        parse_schedule({"faults": [entry]})


@pytest.mark.parametrize(
    ("preset", "median_s", "longest_s"),
    [("wifi-at-range", 0.012, 0.1), ("lte-handover", 0.065, 0.4), ("herelink", 0.04, 0.25)],
)
def test_radios_delay_dense_telemetry_by_what_their_sources_say(
    preset: str, median_s: float, longest_s: float
) -> None:
    """At 350 Hz, PX4's rate on USB, no queue behind one late frame grows."""
    engine = Engine(parse_schedule({"seed": 3, "faults": [{"preset": preset}]}))
    engine.start_at(0)
    late = []
    for t_us in range(0, 60_000_000, 2857):
        sends = engine.apply(frame_of(60), "from-vehicle", t_us)
        late += [(out.due_us - t_us) * 1e-6 for out in sends]
    assert np.median(late) < median_s
    assert max(late) < longest_s

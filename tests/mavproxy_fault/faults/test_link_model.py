"""The link model: rates in bytes, slots, correlation, bit errors, samples and profiles."""

import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.faults.timing import Jitter, random_delay
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


def test_cells_and_a_least_size_are_paid_whole() -> None:
    limit = {"fault": "rate-limit", "value": 1000, "unit": "bytes", "overhead_bytes": 8}
    cells = {**limit, "cell_bytes": 48, "cell_overhead_bytes": 5}
    # 58 + 8 bytes take two cells of 53; 40 + 8 one; 150 + 8 four
    late = [late for _, late in delays([cells], [0, 1, 2], [58, 40, 150])]
    assert late == pytest.approx([0.106, 0.053, 0.212])
    least = [late for _, late in delays([{**limit, "least_bytes": 64}], [0, 1], [40, 100])]
    assert least == pytest.approx([0.064, 0.108])
    shorter = [late for _, late in delays([{**limit, "overhead_bytes": -12}], [0], [40])]
    assert shorter == pytest.approx([0.028])


def test_a_peak_rate_spreads_a_burst() -> None:
    bucket = {"fault": "rate-limit", "value": 1000, "unit": "bytes", "burst_bytes": 400}
    peaked = {**bucket, "peak": 4000, "peak_burst_bytes": 100}
    late = [delay for _, delay in delays([peaked], [1.0] * 6)]
    # the burst at the peak rate, and what has come in meanwhile; then at the mean rate
    assert late == pytest.approx([0.0, 0.025, 0.05, 0.075, 0.1, 0.2])


def test_a_queue_of_frames_takes_so_many() -> None:
    limit = {"fault": "rate-limit", "value": 10, "queue_frames": 2}
    found = delays([limit], [0.0, 0.0, 0.0, 0.0, 0.11])
    # the first leaves at once, two wait, the fourth is lost
    assert [t_s for t_s, _ in found] == [0.0, 0.0, 0.0, 0.11]
    with pytest.raises(ConfigError, match="either queue_s, or queue_bytes or queue_frames"):
        parse_schedule({"faults": [{**limit, "queue_s": 1}]})


def slot_model(times_s: Any, sizes: Any, draw: Any, frames: float, octets: float) -> Any:
    """The delays of netem's `slot`: its dequeue routine, frame by frame."""
    slot_s, left, room, late = 0.0, frames, octets, []
    for t_s, size in zip(times_s, sizes, strict=True):
        if slot_s < t_s:
            slot_s, left, room = t_s + draw(), frames, octets
        late.append(slot_s - t_s)
        left, room = left - 1, room - size
        if left <= 0 or room <= 0:
            slot_s, left, room = slot_s + draw(), frames, octets
    return np.array(late)


@pytest.mark.parametrize(("frames", "octets"), [(None, None), (3, None), (None, 250)])
def test_random_slots_are_those_of_netem(frames: int | None, octets: int | None) -> None:
    rng = np.random.default_rng(8)
    times = np.cumsum(rng.exponential(0.02, 60_000))
    sizes = rng.choice([40, 100, 180], len(times))
    slots = {"fault": "slots", "base_s": 0.01, "value": 0.03, "frames": frames, "bytes": octets}
    fault = {key: value for key, value in slots.items() if value is not None}
    found = delays([fault], times, sizes)
    ours = np.array([late for _, late in found])
    leaving = np.array([t_s for t_s, _ in found]) + ours
    assert np.all(np.diff(leaving) > -1e-5)  # in order
    model = slot_model(
        times, sizes, lambda: rng.uniform(0.01, 0.04), frames or np.inf, octets or np.inf
    )
    assert ours.mean() == pytest.approx(model.mean(), rel=0.02)
    for share in (0.1, 0.5, 0.9):
        assert np.quantile(ours, share) == pytest.approx(np.quantile(model, share), rel=0.04)
    if frames:
        assert np.unique(leaving.round(6), return_counts=True)[1].max() <= frames


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


def test_a_normal_jitter_lies_on_both_sides_of_its_base() -> None:
    jitter = {"fault": "jitter", "value": 0.02, "distribution": "normal", "keep_order": False}
    late = [late for _, late in delays([{**jitter, "base_s": 0.1}], range(20_000))]
    assert np.mean(late) == pytest.approx(0.1, abs=4 * 0.02 / math.sqrt(20_000))
    assert np.std(late) == pytest.approx(0.02, rel=0.03)


@pytest.mark.parametrize("z", [-1.2, 0.0, 1.0, 2.3, 3.5])
def test_pareto_normal_is_a_quarter_of_one_and_three_of_the_other(z: float) -> None:
    """netem's table: the quantiles of both, 0.25 normal + 0.75 (4/3) (Pareto of shape 3 - 1.5)."""
    fault = Jitter(base_s=0.1, value=0.02, distribution="pareto-normal")
    share = 0.5 + 0.5 * math.erf(z / math.sqrt(2))
    table = 0.25 * z + 0.75 * 4 / 3 * ((1 - share) ** (-1 / 3) - 1.5)
    # `delay 110ms 20ms distribution paretonormal`
    assert random_delay(fault.numbers(), z) == pytest.approx(1e6 * (0.11 + 0.02 * table), abs=1)


@pytest.mark.parametrize("kind", ["duplicate", "corrupt", "truncate"])
def test_correlated_choices_keep_their_share(kind: str) -> None:
    engine = Engine(parse_schedule({"seed": 5, "faults": [
        {"fault": kind, "value": 0.2, "correlation": 0.6}
    ]}))  # fmt: skip
    engine.start_at(0)
    frame, count = frame_of(60), 30_000
    chosen = np.zeros(count)
    for n in range(count):
        first, *more = engine.apply(frame, "from-vehicle", 1000 * n)
        chosen[n] = bool(more) or first.frame is not frame
    assert abs(chosen.mean() - 0.2) < 4 * math.sqrt(0.2 * 0.8 / count * 4)
    assert np.corrcoef(chosen[1:], chosen[:-1])[0, 1] == pytest.approx(0.6, abs=0.05)


def test_a_frame_can_be_damaged_anywhere() -> None:
    fault = {"fault": "corrupt", "part": "frame"}
    engine = Engine(parse_schedule({"seed": 5, "faults": [fault]}))
    engine.start_at(0)
    frame, places = frame_of(30), set()
    for n in range(500):
        (out,) = engine.apply(frame, "from-vehicle", 1000 * n)
        assert isinstance(out.frame, bytes)
        pairs = enumerate(zip(out.frame, frame.raw, strict=True))
        places |= {at for at, (a, b) in pairs if a != b}
    assert places == set(range(30))
    with pytest.raises(ConfigError, match="leave out crc: redone"):
        parse_schedule({"faults": [{**fault, "crc": "redone"}]})


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

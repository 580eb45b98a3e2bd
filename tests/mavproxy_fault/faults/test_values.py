"""Effect of each value fault on numbers, by hand-made examples."""

import math
from typing import Any

import numpy as np
import pytest

from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.schedule.entries import parse_schedule
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame

X = "HIL_SENSOR.xgyro"
XYZ = ["HIL_SENSOR.xgyro", "HIL_SENSOR.ygyro", "HIL_SENSOR.zgyro"]


def run(fault: dict[str, Any], rows: list[tuple[float, ...]], step_s: float = 0.1) -> list[Any]:
    """Return the gyro of each sent frame; plain numbers for rows of one."""
    entry = {"target": X if len(rows[0]) == 1 else XYZ, **fault}
    engine = Engine(parse_schedule({"seed": 5, "faults": [entry]}))
    layout = message_layout("HIL_SENSOR")
    found: list[Any] = []
    for i, row in enumerate(rows):
        values = dict(zip(("xgyro", "ygyro", "zgyro"), row, strict=False))
        frame = Frame(build_frame(layout, values, component=51), layout)
        (out,) = engine.apply(frame, "to-vehicle", round(1e6 * step_s * i))
        assert isinstance(out.frame, Frame)
        sent = [float(out.frame.number(n)) for n in ("xgyro", "ygyro", "zgyro")]
        found.append(round(sent[0], 5) if len(row) == 1 else [round(x, 5) for x in sent])
    return found


def ones(*values: float) -> list[tuple[float, ...]]:
    return [(value,) for value in values]


@pytest.mark.parametrize(
    ("fault", "given", "sent"),
    [
        ({"fault": "bias", "value": 0.5}, ones(1, 2), [1.5, 2.5]),
        ({"fault": "bias", "value": [1, 2, 3]}, [(1, 1, 1)], [[2, 3, 4]]),
        ({"fault": "scale", "value": -2}, ones(1, 2), [-2, -4]),
        ({"fault": "constant", "value": 7}, ones(1, 2), [7, 7]),
        ({"fault": "drift", "value": 10, "limit": 1.5}, ones(1, 1, 1), [1, 2, 2.5]),
        ({"fault": "ramp", "value": 10}, ones(1, 1, 1), [1, 2, 3]),
        ({"fault": "stuck"}, ones(3, 4, 5), [3, 3, 3]),
        ({"fault": "replay", "value": 0.25}, ones(1, 2, 3, 4, 5, 6, 7), [1, 2, 3, 1, 2, 3, 1]),
        ({"fault": "lag", "value": 0.2}, ones(1, 2, 3, 4, 5), [1, 1, 1, 2, 3]),
        ({"fault": "sample-hold", "value": 0.2}, ones(1, 2, 3, 4, 5), [1, 1, 3, 3, 5]),
        ({"fault": "slew-limit", "value": 5}, ones(0, 2, 2, -2), [0, 0.5, 1, 0.5]),
        ({"fault": "quantise", "value": 0.5}, ones(0.2, 0.3, -0.8), [0, 0.5, -1]),
        ({"fault": "saturate", "value": 1}, ones(3, 0.5, -3), [1, 0.5, -1]),
        ({"fault": "saturate", "low": -1, "high": 2}, ones(3, 0.5, -3), [2, 0.5, -1]),
        ({"fault": "dead-band", "value": 1}, ones(0.9, 1.5, -3), [0, 0.5, -2]),
        ({"fault": "axis-swap"}, [(1, 2, 3)], [[3, 2, 1]]),
        ({"fault": "axis-swap", "order": [1, 0, 2]}, [(1, 2, 3)], [[2, 1, 3]]),
        ({"fault": "axis-swap", "signs": [1, -1, 1]}, [(1, 2, 3)], [[3, -2, 1]]),
        ({"fault": "rotation", "angles_deg": [0, 0, 90]}, [(1, 0, 5)], [[0, -1, 5]]),
        ({"fault": "rotation", "angles_deg": [90, 0, 0]}, [(0, 0, 1)], [[0, 1, 0]]),
        ({"fault": "iron", "hard": [1, 0, 0]}, [(1, 2, 3)], [[2, 2, 3]]),
        (
            {"fault": "iron", "soft": [[2, 0, 0], [0, 1, 1], [0, 0, 1]]},
            [(1, 2, 3)],
            [[2, 5, 3]],
        ),
        (
            {"fault": "impulse", "value": 5, "period_s": 0.3, "width_s": 0.1},
            ones(1, 1, 1, 1, 1),
            [6, 1, 1, 6, 1],
        ),
        ({"fault": "sine", "value": 2, "frequency_hz": 2.5}, ones(1, 1, 1, 1), [1, 3, 1, -1]),
        ({"fault": "cycle", "value": 9, "period_s": 0.1}, [(0, 0, 0)] * 4,
         [[9, 0, 0], [0, 9, 0], [0, 0, 9], [9, 0, 0]]),
    ],
)  # fmt: skip
def test_a_fault_turns_healthy_values_into_faulty_ones(fault: Any, given: Any, sent: Any) -> None:
    assert run(fault, given) == sent


def test_a_float_decays_exponentially() -> None:
    sent = run({"fault": "float", "settle_s": 0.1, "neutral": 1}, ones(3, 3, 9))
    assert sent == pytest.approx([3, 1 + 2 * math.exp(-1), 1 + 2 * math.exp(-2)], abs=1e-4)


def test_nan_is_sent() -> None:
    assert math.isnan(run({"fault": "nan"}, ones(1))[0])
    assert run({"fault": "not-a-number", "value": "-inf"}, ones(1)) == [-math.inf]


def test_a_flipped_bit_is_one_bit() -> None:
    assert run({"fault": "bit-flip", "bit": 31}, ones(1.5)) == [-1.5]


def test_flipping_a_bit_twice_restores_the_value() -> None:
    entry = {"fault": "bit-flip", "target": X, "bit": 3}
    engine = Engine(parse_schedule({"faults": [{"id": "a", **entry}, {"id": "b", **entry}]}))
    layout = message_layout("HIL_SENSOR")
    frame = Frame(build_frame(layout, {"xgyro": 1.5, "id": 1}), layout)
    (out,) = engine.apply(frame, "to-vehicle", 0)
    assert isinstance(out.frame, Frame)
    assert out.frame.raw == frame.raw


def test_noise_has_its_sigma_and_no_mean() -> None:
    sent = np.array(run({"fault": "noise", "value": 2}, ones(*[10.0] * 4000))) - 10
    assert abs(sent.mean()) < 4 * 2 / math.sqrt(4000)
    # the sample variance of n normal draws has a relative sigma of sqrt(2 / n)
    assert sent.var() / 4 == pytest.approx(1, abs=4 * math.sqrt(2 / 4000))


def test_uniform_noise_stays_within_its_bounds() -> None:
    fault = {"fault": "noise", "value": 2, "distribution": "uniform"}
    sent = np.array(run(fault, ones(*[0.0] * 2000)))
    assert np.abs(sent).max() <= 2
    assert sent.var() == pytest.approx(4 / 3, rel=4 * math.sqrt(0.8 / 2000))


def test_the_variance_of_a_random_walk_grows_with_time() -> None:
    ends = []
    for seed in range(200):
        engine = Engine(
            parse_schedule(
                {"seed": seed, "faults": [{"fault": "random-walk", "target": X, "value": 0.5}]}
            )
        )
        layout = message_layout("HIL_SENSOR")
        frame = Frame(build_frame(layout, {"id": 1}), layout)
        for i in range(17):
            (out,) = engine.apply(frame, "to-vehicle", i * 1_000_000)
        assert isinstance(out.frame, Frame)
        ends.append(float(out.frame.number("xgyro")))
    # after 16 s sigma is 0.5 * 4; a sample variance of 200 has a relative sigma of sqrt(2 / 200)
    assert np.var(ends) / 4 == pytest.approx(1, abs=4 * math.sqrt(2 / 200))


def test_flags_are_cleared_by_group_and_by_mask() -> None:
    layout = message_layout("HIL_SENSOR")
    frame = Frame(build_frame(layout, {"fields_updated": 0x1FFF}), layout)
    for keys, left in [({"groups": ["baro", "gyro"]}, 0x5C7), ({"value": 0x7}, 0x1FF8)]:
        entry = {"fault": "clear-bits", "target": "HIL_SENSOR.fields_updated", **keys}
        engine = Engine(parse_schedule({"faults": [entry]}))
        (out,) = engine.apply(frame, "to-vehicle", 0)
        assert isinstance(out.frame, Frame)
        assert out.frame.number("fields_updated") == left


@pytest.mark.parametrize(
    ("value", "sent"), [(40_000, 32767), (-1e9, -32768), (0.6, 101), (float("1e308"), 32767)]
)
def test_integers_saturate_and_round_and_never_wrap(value: float, sent: int) -> None:
    layout = message_layout("HIL_GPS")
    entry = {"id": "it", "fault": "bias", "target": "HIL_GPS.vn", "value": value}
    engine = Engine(parse_schedule({"faults": [entry]}))
    (out,) = engine.apply(
        Frame(build_frame(layout, {"vn": 100, "yaw": 1}), layout), "to-vehicle", 0
    )
    assert isinstance(out.frame, Frame)
    assert out.frame.number("vn") == sent
    assert engine.state()["faults"][0]["saturated"] == (abs(value) > 1)


def test_a_fault_in_truncated_zeros_reads_back() -> None:
    layout = message_layout("HIL_SENSOR")
    short = Frame(build_frame(layout, {"time_usec": 5}), layout)
    entry = {"fault": "bias", "target": "HIL_SENSOR.temperature", "value": 21.5}
    engine = Engine(parse_schedule({"faults": [entry]}))
    (out,) = engine.apply(short, "to-vehicle", 0)
    assert isinstance(out.frame, Frame)
    assert (out.frame.number("temperature"), out.frame.number("time_usec")) == (21.5, 5)

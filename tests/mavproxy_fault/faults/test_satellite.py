import pytest

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.fault_parts.fault import Outgoing
from mavproxy_fault.fault_parts.value_fault import MOST_SENDERS
from mavproxy_fault.faults.satellite import HOLD_US
from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.rtcm.msm7 import decode_msm7, encode_epoch
from mavproxy_fault.rtcm.transport import Reassembler, tunnel_frames, tunnel_payload
from mavproxy_fault.schedule.entries import parse_schedule
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame
from mavproxy_fault.wire.plant_messages import plant_change

NAMES = tuple(f"G{n:02d}" for n in range(2, 22, 2))
TUNNEL = message_layout("TUNNEL")


def message(tow_s: float) -> bytes:
    many = len(NAMES)
    ranges = [2.1e7 + 1e5 * i for i in range(many)]
    return encode_epoch(tow_s, NAMES, ranges, [100.0] * many, [45.0] * many)[0]


def fragments(epoch: int) -> list[Frame]:
    made = tunnel_frames(message(100.0 + epoch), epoch, seq=4 * epoch)
    assert len(made) > 1
    return [Frame(raw, TUNNEL) for raw in made]


def engine(*faults: dict[str, object]) -> Engine:
    it = Engine(parse_schedule({"seed": 2, "faults": list(faults)}))
    it.start_at(0)
    return it


def pushed(it: Engine, epochs: int) -> list[Outgoing]:
    return [
        out
        for epoch in range(epochs)
        for frame in fragments(epoch)
        for out in it.apply(frame, "to-vehicle", (epoch + 1) * 1_000_000)
    ]


def read(outs: list[Outgoing]) -> list[dict[str, float]]:
    """Return the range error [m] by satellite for each message, without lost ones."""
    together = Reassembler()
    healthy = decode_msm7(message(0))
    ranges = dict(zip(healthy.satellites, healthy.pseudorange_m, strict=True))
    found = []
    for out in outs:
        assert isinstance(out.frame, Frame)
        payload = tunnel_payload(out.frame)
        assert payload is not None
        for whole in together.add(payload):
            data = decode_msm7(whole)
            rows = zip(data.satellites, data.pseudorange_m, strict=True)
            found.append({name: metres - ranges[name] for name, metres in rows})
    return found


def test_a_step_acts_on_its_satellite_alone() -> None:
    outs = pushed(engine({"fault": "bias", "target": "PSEUDORANGE.G12", "value": 50}), 3)
    for off in read(outs):
        assert off.pop("G12") == pytest.approx(50, abs=1e-3)
        assert set(off.values()) == {0.0}
        assert len(off) == len(NAMES) - 1


def test_a_ramp_grows_with_the_vehicle_s_time() -> None:
    outs = pushed(engine({"fault": "drift", "target": "PSEUDORANGE.G12", "value": 2}), 4)
    assert [off["G12"] for off in read(outs)] == pytest.approx([2, 4, 6, 8], abs=1e-3)


def test_a_lost_satellite_is_missing_and_the_others_stay() -> None:
    outs = pushed(engine({"fault": "drop", "target": ["PSEUDORANGE.G02", "PSEUDORANGE.G04"]}), 2)
    assert [sorted(off) for off in read(outs)] == [sorted(NAMES[2:])] * 2


def test_a_cycle_moves_from_one_satellite_to_the_next() -> None:
    it = engine(
        {
            "fault": "cycle",
            "target": ["PSEUDORANGE.G06", "PSEUDORANGE.G08"],
            "value": 30,
            "period_s": 2,
        }
    )
    faulty = [[n for n, off in row.items() if off > 1] for row in read(pushed(it, 5))]
    assert faulty == [["G06"], ["G08"], ["G08"], ["G06"], ["G06"]]


def test_two_faults_on_two_satellites_act_together() -> None:
    it = engine(
        {"fault": "bias", "target": "PSEUDORANGE.G06", "value": 20},
        {"fault": "bias", "target": "PSEUDORANGE.G08", "value": -20},
    )
    (off,) = read(pushed(it, 1))
    assert (off["G06"], off["G08"]) == (pytest.approx(20, abs=1e-3), pytest.approx(-20, abs=1e-3))


def test_a_missing_satellite_changes_no_byte_and_has_no_label() -> None:
    it = engine({"fault": "bias", "target": "PSEUDORANGE.E05", "value": 50})
    outs = pushed(it, 2)
    sent = [frame.raw for epoch in range(2) for frame in fragments(epoch)]
    assert [out.frame.raw for out in outs if isinstance(out.frame, Frame)] == sent
    assert it.finish(10_000_000) == []


def test_fragments_keep_their_headers() -> None:
    outs = pushed(engine({"fault": "bias", "target": "PSEUDORANGE.G12", "value": 50}), 1)
    for before, out in zip(fragments(0), outs, strict=True):
        assert isinstance(out.frame, Frame)
        assert (out.frame.seq, out.frame.system, out.frame.component) == (before.seq, 1, 51)


def test_an_incomplete_message_is_sent_after_its_timeout() -> None:
    it = engine({"fault": "bias", "target": "PSEUDORANGE.G12", "value": 50})
    first = fragments(0)[0]
    assert it.apply(first, "to-vehicle", 1_000_000) == []
    assert it.release_us == 1_000_000 + HOLD_US
    assert it.due(1_000_000 + HOLD_US - 1) == []
    (out,) = it.due(1_000_000 + HOLD_US)
    assert out.frame is first
    assert it.release_us is None


def test_a_fault_that_ends_sends_its_buffered_fragments() -> None:
    it = engine({"fault": "bias", "target": "PSEUDORANGE.G12", "value": 50, "for_s": 1.1})
    first = fragments(0)[0]
    it.apply(first, "to-vehicle", 1_000_000)
    assert [out.frame for out in it.due(1_100_000)] == [first]


def test_the_number_of_incomplete_messages_is_bounded() -> None:
    it = engine({"fault": "bias", "target": "PSEUDORANGE.G12", "value": 5.0})
    first = fragments(0)[0]
    came, left = [], []
    for sender in range(2 * MOST_SENDERS):
        raw = bytearray(first.raw)
        raw[5], raw[6] = 1 + sender // 200, sender % 200
        frame = Frame(bytes(raw), first.layout).with_payload(first.payload)
        came.append(frame.raw)
        left += [out.frame.raw for out in it.apply(frame, "to-vehicle", 1_000_000)]
    assert left == came[: len(came) - MOST_SENDERS]


def test_other_tunnel_messages_are_forwarded() -> None:
    it = engine({"fault": "bias", "target": "PSEUDORANGE.G12", "value": 50})
    raw = bytearray(fragments(0)[0].payload)
    raw[0] ^= 1  # another payload type
    other = fragments(0)[0].with_payload(bytes(raw))
    (out,) = it.apply(other, "to-vehicle", 1)
    assert out.frame is other


def test_a_satellite_fault_can_act_in_the_simulated_receiver() -> None:
    from mavproxy_fault.wire.frame import build_frame

    it = engine(
        {"fault": "drift", "target": "PSEUDORANGE.G12", "value": 2, "via": "simulator", "for_s": 1}
    )
    layout = message_layout("HIL_SENSOR")
    messages = []
    for t_us in range(0, 1_200_000, 100_000):
        frame = Frame(build_frame(layout, {"time_usec": t_us}, component=51), layout)
        outs = it.apply(frame, "to-vehicle", t_us)
        assert frame in [out.frame for out in outs]
        messages += [plant_change(o.frame) for o in outs if o.back and isinstance(o.frame, Frame)]
    values = [change.value for change in messages if change is not None]
    assert {change.name for change in messages if change is not None} == {"pseudorange_m[G12]"}
    assert values[:-1] == pytest.approx([0.2 * i for i in range(10)])
    assert values[-1] is None


def test_the_receiver_loses_a_satellite_entirely_or_not_at_all() -> None:
    with pytest.raises(ConfigError, match=r"value = 0.5 cannot act in the receiver"):
        engine({"fault": "drop", "target": "PSEUDORANGE.G12", "value": 0.5, "via": "simulator"})

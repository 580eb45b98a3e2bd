"""The effect of every preset, checked with pymavlink's decoder."""

from typing import Any

import pytest
from pymavlink.dialects.v20 import all as pymavlink

from mavproxy_fault.app.preview import RANGE_M, healthy_frame
from mavproxy_fault.faults.satellite import SatelliteFault
from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.rtcm.msm7 import encode_epoch, msm7_satellites
from mavproxy_fault.rtcm.transport import tunnel_frames, tunnel_payload
from mavproxy_fault.schedule.entries import Entry, parse_schedule
from mavproxy_fault.schedule.presets import preset_names, read_preset
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame
from mavproxy_fault.wire.plant_messages import plant_change

START_US = 2_000_000
STEP_US = 20_000
FRAMES = 200  # 4 s
DECODER = pymavlink.MAVLink(None)


def decoded(frame: Frame | bytes) -> dict[str, Any]:
    raw = frame if isinstance(frame, bytes) else frame.raw
    values: dict[str, Any] = DECODER.decode(bytearray(raw)).to_dict()
    return values


def messages(entries: list[Entry]) -> set[str]:
    """Return the messages that the entries act on; HIL_SENSOR for those that act on all."""
    found: set[str] = set()
    for entry in entries:
        for name in entry.targets or getattr(entry.fault, "messages", ("HIL_SENSOR",)):
            head = name.split(".")[0]
            found.add("HIL_SENSOR" if head == "PLANT" else head)
    return found - {"PSEUDORANGE"}  # which `healthy_epoch` makes


def healthy_epoch(names: list[str], t_s: float) -> bytes:
    zeros = [0.0] * len(names)
    (message,) = encode_epoch(t_s, names, [RANGE_M] * len(names), zeros, zeros)
    return message


def sent_by(frame: Frame, entry: Entry) -> Frame:
    """Return the frame of the system that an entry acts on."""
    if entry.where.system is None:
        return frame
    values = {name: frame.read(name) for name in frame.layout.fields}
    return Frame(build_frame(frame.layout, values, system=entry.where.system), frame.layout)


def targets(name: str) -> set[str]:
    """Return the fields, messages and satellites that a preset names."""
    found: set[str] = set()
    for part in read_preset(name)["faults"]:
        given = part.get("target", [])
        found |= {given} if isinstance(given, str) else set(given)
    return found


def silenced(name: str) -> set[str]:
    """Return the messages that a preset drops."""
    return {one for one in targets(name) if "." not in one}


def changes(name: str) -> tuple[set[str], int, list[Any]]:
    """Return changed fields, number of dropped, late or duplicated frames, and replies."""
    schedule = parse_schedule({"seed": 1, "faults": [{"preset": name, "id": "it"}]})
    engine = Engine(schedule)
    engine.start_at(START_US)
    fields: set[str] = set()
    moved = 0
    replies = []
    for i in range(FRAMES):
        t_us = START_US + i * STEP_US
        for message in sorted(messages(list(schedule.faults))):
            healthy = sent_by(healthy_frame(message, t_us * 1e-6), schedule.faults[0])
            outs = engine.apply(healthy, "to-vehicle", t_us)
            replies += [
                plant_change(o.frame) for o in outs if o.back and isinstance(o.frame, Frame)
            ]
            outs = [out for out in outs if not out.back]
            moved += [out.due_us for out in outs] != [t_us]
            changed = [out.frame for out in outs if out.frame is not healthy]
            before = decoded(healthy) if changed else {}
            for frame in changed:
                after = decoded(frame)
                fields |= {f"{message}.{k}" for k in before if repr(before[k]) != repr(after[k])}
    return fields, moved, replies


def kind(name: str) -> str:
    faults = {part["fault"] for part in read_preset(name)["faults"]}
    of_links = {"outage", "drop", "gilbert-elliott", "jitter", "duplicate"}
    of_links |= {"delay", "rate-limit", "radio"}
    if faults <= of_links:
        targets = str(read_preset(name)["faults"][0].get("target", ""))
        return "satellites" if "PSEUDORANGE" in targets else "link"
    if "PSEUDORANGE" in str(read_preset(name)["faults"][0].get("target", "")):
        return "satellites"
    if faults & {"gps-spoof", "time-jump"}:
        return "coherent"
    if "command" in faults:
        return "command"
    return "plant" if "plant" in faults else "fields"


NAMES = preset_names()


def of_kind(chosen: str) -> list[str]:
    return [name for name in NAMES if kind(name) == chosen]


@pytest.mark.parametrize("name", of_kind("fields"))
def test_a_preset_changes_its_targets_and_nothing_else(name: str) -> None:
    fields, moved, replies = changes(name)
    named = {target.split("[")[0] for target in targets(name) if "." in target}
    assert fields
    assert fields <= named
    assert (moved, replies) == (FRAMES * len(silenced(name)), [])


@pytest.mark.parametrize("name", of_kind("command"))
def test_an_auxiliary_function_changes_no_frame(name: str) -> None:
    assert changes(name)[:2] == (set(), 0)


@pytest.mark.parametrize("name", of_kind("link"))
def test_a_link_preset_drops_delays_or_duplicates_frames_without_changing_them(name: str) -> None:
    fields, moved, _ = changes(name)
    assert fields == set()
    assert moved > 0


@pytest.mark.parametrize("name", of_kind("plant"))
def test_a_plant_preset_is_sent_to_the_simulator_and_changes_no_frame(name: str) -> None:
    fields, moved, replies = changes(name)
    assert (fields, moved) == (set(), 0)
    assert {change.name for change in replies} <= {
        part["target"].removeprefix("PLANT.") for part in read_preset(name)["faults"]
    }
    assert len(replies) >= 15  # every 0.2 s


@pytest.mark.parametrize("name", of_kind("coherent"))
def test_a_coherent_preset_moves_every_message_of_its_kind(name: str) -> None:
    fields, moved, _ = changes(name)
    assert moved == 0
    if name == "clock-jump":
        assert {field.split(".")[0] for field in fields} == targets(name)
        assert {field.split(".")[1] for field in fields} == {"time_usec", "time_boot_ms"}
    elif name == "gps-velocity-error":
        assert {field.split(".")[0] for field in fields} == targets(name)
        assert not {field.split(".")[1] for field in fields} & {"lat", "lon", "alt"}
    else:
        moved_latitudes = {field.split(".")[0] for field in fields if field.endswith(".lat")}
        assert moved_latitudes == {
            "HIL_GPS", "GPS_RAW_INT", "GPS2_RAW", "GPS_INPUT", "GLOBAL_POSITION_INT",
        }  # fmt: skip


@pytest.mark.parametrize("name", of_kind("satellites"))
def test_a_preset_of_satellites_patches_the_tunnelled_ranges(name: str) -> None:
    (entry,) = parse_schedule({"seed": 1, "faults": [{"preset": name}]}).faults
    assert isinstance(entry.fault, SatelliteFault)
    engine = Engine(parse_schedule({"seed": 1, "faults": [{"preset": name}]}))
    engine.start_at(0)
    touched = 0
    for second in range(1, 4):
        for system in {satellite[0] for satellite in entry.fault.names}:
            names = sorted({s for s in entry.fault.names if s[0] == system} | {f"{system}30"})
            frames = [
                Frame(raw, message_layout("TUNNEL"))
                for raw in tunnel_frames(healthy_epoch(names, second), second)
            ]
            outs = [
                out for one in frames for out in engine.apply(one, "to-vehicle", second * 1_000_000)
            ]
            assert all(decoded(out.frame)["payload_type"] == 33845 for out in outs)
            touched += [out.frame for out in outs] != frames
    assert touched >= 3


def test_every_preset_is_described_in_one_line() -> None:
    kinds = "fields", "link", "plant", "coherent", "satellites", "command"
    assert sum(len(of_kind(kind)) for kind in kinds) == len(NAMES)
    for name in NAMES:
        about = read_preset(name)["about"]
        assert "\n" not in about
        assert 20 < len(about) < 110


def test_the_times_of_an_entry_apply_to_all_parts_of_its_preset() -> None:
    entry = {"preset": "imu-impulse", "id": "blow", "at_s": 5, "for_s": 3}
    schedule = parse_schedule({"faults": [entry]})
    assert [(e.id, e.at_s, e.for_s, e.preset) for e in schedule.faults] == [
        ("blow.1", 5, 3, "imu-impulse"),
        ("blow.2", 5, 3, "imu-impulse"),
    ]


IMU = ("HIL_SENSOR", "HIGHRES_IMU", "RAW_IMU", "SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3")


@pytest.mark.parametrize(
    ("name", "field", "per_si"),
    [
        ("gyro-bias", "xgyro", 1e3),
        ("accel-bias", "xacc", 1e3 / 9.80665),
        ("mag-offset", "xmag", 1e3),
    ],
)
def test_a_preset_acts_on_every_message_of_the_sensor_in_its_unit(
    name: str, field: str, per_si: float
) -> None:
    engine = Engine(parse_schedule({"faults": [{"preset": name}]}))
    engine.start_at(0)
    steps = {}
    for message in IMU:
        healthy = healthy_frame(message, 1.0)
        (out,) = engine.apply(healthy, "to-vehicle", 1_000_000)
        assert isinstance(out.frame, Frame)
        counts = out.frame.number(field) - healthy.number(field)
        steps[message] = counts / (1.0 if message in IMU[:2] else per_si)
    size = {"gyro-bias": 0.1, "accel-bias": 1.0, "mag-offset": 0.1}[name]
    assert steps == {message: pytest.approx(size, abs=0.006) for message in IMU}


def test_a_receiver_without_satellites_has_no_ranges() -> None:
    engine = Engine(parse_schedule({"faults": [{"preset": "gps-search-failure"}]}))
    engine.start_at(0)
    names = ["G05", "G12", "G30"]
    frames = [
        Frame(raw, message_layout("TUNNEL")) for raw in tunnel_frames(healthy_epoch(names, 1), 1)
    ]
    outs = [out for one in frames for out in engine.apply(one, "to-vehicle", 1_000_000)]
    payloads = [tunnel_payload(out.frame) for out in outs if isinstance(out.frame, Frame)]
    (payload,) = [payload for payload in payloads if payload is not None]
    assert msm7_satellites(payload[1:]) == ()

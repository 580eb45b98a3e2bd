"""MAV_CMD_INJECT_FAILURE through the whole core, against the bytes that each unit may change.

`python tests/mavproxy_fault/live/test_failure_bytes.py` tries every unit, type and instance of
today's common.xml and counts; the tests try a part of them. The judge is a table written from
common.xml, and pymavlink, which packs and reads all frames.
"""

import random
import sys
from collections import Counter
from collections.abc import Iterable, Iterator
from typing import Any

import pytest
from pymavlink.dialects.v20 import all as judge

from mavproxy_fault.live.control import LiveControl
from mavproxy_fault.live.edit_log import join_live_control
from mavproxy_fault.live.failure_command import FailureRequest
from mavproxy_fault.proxy.core import Core, LinkRole, Send
from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.schedule.entries import Schedule, parse_schedule
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame
from mavproxy_fault.wire.label import latest_labels

VEHICLE, SIMULATOR, STATION, OTHER_STATION = range(4)
ROLES = (
    LinkRole("vehicle", "from-vehicle"), LinkRole("simulator", "to-vehicle"),
    LinkRole("station", "to-vehicle"), LinkRole("other", "to-vehicle"),
)  # fmt: skip
NAN = float("nan")
START_US, ROUND_US, ROUNDS = 1_700_000_000_000_000, 110_000, 20  # two cycles of "intermittent"
ACCEPTED, DENIED = 0, 2
TYPES = range(1, 9)

# Of each unit: the messages that carry it to an autopilot, their instance field, and the fields
# (and update flags) that a failure may change.
SENSOR = {
    0: ({"xgyro", "ygyro", "zgyro"}, 0x38), 1: ({"xacc", "yacc", "zacc"}, 0x7),
    2: ({"xmag", "ymag", "zmag"}, 0x1C0), 3: ({"abs_pressure", "pressure_alt"}, 0x1A00),
    8: ({"diff_pressure"}, 0x400),
}  # fmt: skip
POSITION = {"lat", "lon", "alt"}
OWN: dict[int, dict[str, tuple[str, set[str]]]] = {
    4: {"HIL_GPS": ("id", POSITION), "GPS_INPUT": ("gps_id", POSITION)},
    5: {
        "HIL_OPTICAL_FLOW": ("", {"integrated_x", "integrated_y"}),
        "OPTICAL_FLOW_RAD": ("sensor_id", {"integrated_x", "integrated_y"}),
        "OPTICAL_FLOW": ("", {"flow_x", "flow_y"}),
    },
    6: {"ODOMETRY": ("", {"x", "y", "z"}), "VISION_POSITION_ESTIMATE": ("", {"x", "y", "z"})},
    7: {"DISTANCE_SENSOR": ("id", {"current_distance"})},
    100: {"BATTERY_STATUS": ("id", {"voltages"})},
    103: {"OBSTACLE_DISTANCE": ("", {"distances"})},
    104: {
        "RC_CHANNELS_OVERRIDE": ("", {f"chan{n}_raw" for n in range(1, 9)}),
        "MANUAL_CONTROL": ("", {"x", "y", "z", "r"}),
    },
    107: {"ADSB_VEHICLE": ("", {"lat", "lon", "altitude"})},
}
MOTORS = (101, 102)
LINK = (105, 108)
NO_CARRIER = (106, 109, 110)
UNITS = [*SENSOR, *OWN, *MOTORS, *LINK, *NO_CARRIER]
INSTANCES = (1, 2, 3)
MASKS = (*range(16), 0xFFFF)
PACKED: dict[tuple[int, int], list[tuple[tuple[str, int], int, bytes]]] = {}
# For `main`: each further bit (two beyond the standard's sixteen instances), and any of them.
WIDE_MASKS = (
    *MASKS,
    *(1 << n for n in range(4, 18)),
    *random.Random(1).sample(range(16, 0xFFFF), 20),
)


class Traffic:
    """Healthy frames of the messages of a unit, each stream with a component of its own."""

    def __init__(self, unit: int) -> None:
        if unit in SENSOR:
            carried = {"HIL_SENSOR": "id"}
        elif unit in MOTORS:
            carried = {"HIL_ACTUATOR_CONTROLS": ""}
        else:
            carried = {name: field for name, (field, _) in OWN.get(unit, {}).items()}
            # Two streams: more than the ten frames per second of a slow link.
            carried = carried or {"ATTITUDE": "", "LOCAL_POSITION_NED": ""}
        self.streams = [
            (name, field, instance)
            for name, field in carried.items()
            for instance in (INSTANCES if field else (1,))
        ]
        self.unit, self.number = unit, 0

    def round(self) -> Iterable[tuple[tuple[str, int], int, bytes]]:
        """One frame of every stream: its key, link and bytes; the same for each case of a unit."""
        self.number += 1
        if (self.unit, self.number) not in PACKED:
            PACKED[self.unit, self.number] = list(self.packed())
        return PACKED[self.unit, self.number]

    def packed(self) -> Iterator[tuple[tuple[str, int], int, bytes]]:
        """The frames of a round, packed by pymavlink."""
        for place, (name, field, instance) in enumerate(self.streams):
            kind = next(one for one in judge.mavlink_map.values() if one.msgname == name)
            values = {n: self.value(n, t, c) for n, t, c in zip(
                kind.ordered_fieldnames,
                [dict(zip(kind.fieldnames, kind.fieldtypes, strict=True))[n]
                 for n in kind.ordered_fieldnames], kind.array_lengths, strict=True)}  # fmt: skip
            values |= {"fields_updated": 0x1FFF} if "fields_updated" in values else {}
            values |= {field: instance - 1} if field else {}
            values |= {n: 1 for n in ("target_system", "target") if n in values}
            values |= {"target_component": 0} if "target_component" in values else {}
            from_vehicle = name == "HIL_ACTUATOR_CONTROLS"
            sender = judge.MAVLink(None, 1, 1 if from_vehicle else 51 + place)
            sender.seq = self.number % 256
            raw = bytes(kind(*(values[n] for n in kind.fieldnames)).pack(sender))
            yield (name, instance), VEHICLE if from_vehicle else SIMULATOR, raw

    def value(self, name: str, kind: str, count: int) -> Any:
        """A value that changes from frame to frame; stamps count microseconds or milliseconds."""
        if name in ("time_usec", "time_boot_ms"):
            return self.number * ROUND_US // (1 if name == "time_usec" else 1000)
        if kind == "char":
            return b"a"
        one = 20 + self.number % 50
        if name == "controls":
            return [(i + one) / 100 for i in range(16)]
        return [one] * count if count else one


def answers(sends: Iterable[Send]) -> list[tuple[int, int, int]]:
    """Link, result and system of each reply."""
    found = []
    for one in sends:
        message = judge.MAVLink(None).parse_buffer(bytearray(one.data))[0]
        if message.get_type() == "COMMAND_ACK":
            found.append((one.link, message.result, message.get_srcSystem()))
    return found


def command(unit: float, kind: float, p3: float, p4: float, *, as_int: bool = False) -> bytes:
    sender = judge.MAVLink(None, 255, 190)
    if as_int:
        placed = (1, 1, 0, 420, 0, 0, unit, kind, p3, p4, 0, 0, 0)
        return bytes(judge.MAVLink_command_int_message(*placed).pack(sender))
    given = (1, 1, 420, 0, unit, kind, p3, p4, 0, 0, 0)
    return bytes(judge.MAVLink_command_long_message(*given).pack(sender))


def heartbeat(system: int = 1) -> bytes:
    sender = judge.MAVLink(None, system, 1)
    return bytes(judge.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3).pack(sender))


def started_core() -> Core:
    core = Core(ROLES)
    join_live_control(core, LiveControl(Engine(Schedule(1))))
    core.received(VEHICLE, heartbeat(), START_US)
    return core


def changed_fields(before: bytes, after: bytes) -> set[str]:
    """The fields that differ, and update flags as numbers."""
    old, new = (judge.MAVLink(None).parse_buffer(bytearray(raw))[0] for raw in (before, after))
    found = {name for name in old.fieldnames if getattr(old, name) != getattr(new, name)}
    if "fields_updated" in found:
        found.remove("fields_updated")
        flags = old.fields_updated ^ new.fields_updated
        found |= {f"flag {bit}" for bit in range(32) if flags >> bit & 1}
    if "controls" in found:
        found.remove("controls")
        pairs = zip(old.controls, new.controls, strict=True)
        found |= {f"controls {i}" for i, (a, b) in enumerate(pairs) if a != b}
    return found


def allowed_fields(unit: int, name: str, addressed: set[int]) -> set[str]:
    """What a failure of these instances may change in a message."""
    if unit in SENSOR:
        fields, flags = SENSOR[unit]
        return fields | {f"flag {bit}" for bit in range(32) if flags >> bit & 1}
    if unit in MOTORS:
        return {f"controls {n - 1}" for n in addressed}
    return OWN[unit][name][1]


def judge_case(unit: int, kind: int, p3: float, p4: float, *, as_int: bool = False) -> list[str]:
    """Inject one failure, then end it; return what is wrong."""
    core, traffic = started_core(), Traffic(unit)
    now_us = START_US
    for _ in range(4):
        now_us += ROUND_US
        for _, link, raw in traffic.round():
            core.received(link, raw, now_us)
    by_mask = p3 != p3
    chosen = {n for n in range(1, 33) if int(p4) >> n - 1 & 1} if by_mask else {int(p3)}
    everything = p4 == 0xFFFF if by_mask else p3 == 0
    has_instances = any(field for _, field, _ in traffic.streams)
    known = set(range(1, 17)) if unit in MOTORS else set(INSTANCES if has_instances else (1,))
    addressed = known if everything else chosen
    sends = core.received(STATION, command(unit, kind, p3, p4, as_int=as_int), now_us)
    replied, forwarded = answers(sends), [one.link for one in sends if one.link == VEHICLE]
    unaddressed = by_mask and not chosen
    if unit in NO_CARRIER or not addressed <= known:
        right = not replied and forwarded
    elif unaddressed:
        right = replied == [(STATION, DENIED, 1)] and not forwarded
    else:
        right = replied == [(STATION, ACCEPTED, 1)] and not forwarded
    wrong = [] if right else [f"replied {replied}, forwarded to {forwarded}"]
    active = addressed if replied and replied[0][1] == ACCEPTED else set()
    wrong += judge_rounds(core, traffic, unit, now_us, active)
    now_us += (ROUNDS + 10) * ROUND_US  # delayed frames have left
    core.due(now_us)
    if active:
        ended = core.received(STATION, command(unit, 0, p3, p4, as_int=as_int), now_us)
        if answers(ended)[0][1] != ACCEPTED:
            wrong.append("ok was not accepted")
        wrong += [f"after ok: {one}" for one in judge_rounds(core, traffic, unit, now_us, set())]
    return wrong


def judge_rounds(
    core: Core, traffic: Traffic, unit: int, now_us: int, addressed: set[int]
) -> list[str]:
    """Pass traffic and compare what leaves with what came."""
    came: dict[tuple[str, int], list[bytes]] = {}
    left: dict[tuple[str, int], list[bytes]] = {}
    keys: dict[bytes, tuple[str, int]] = {}  # by component and sequence number
    for _ in range(ROUNDS):
        now_us += ROUND_US
        for key, link, raw in traffic.round():
            came.setdefault(key, []).append(raw)
            keys[raw[4:7]] = key
            outputs = core.due(now_us) + core.received(link, raw, now_us)
            for one in outputs:
                # Each frame goes to several endpoints; corrupted ones cannot be attributed.
                wanted = SIMULATOR if key[0] == "HIL_ACTUATOR_CONTROLS" else VEHICLE
                whose = keys.get(one.data[4:7])
                if one.link == wanted and whose is not None and one.data[7:10] == raw[7:10]:
                    left.setdefault(whose, []).append(one.data)
    wrong = []
    for key, sent in came.items():
        name, instance = key
        met = unit in MOTORS or unit in LINK or instance in addressed
        if not (addressed and met):
            if left.get(key, []) != sent:
                wrong.append(f"{name} {instance} is not addressed and changed")
            continue
        if unit in LINK:
            wrong += ["accepted without effect"] if left == came else []
            continue
        if left.get(key, []) == sent:
            wrong.append(f"{name} {instance}: accepted without effect")
        originals = {raw[4:7]: raw for raw in sent}
        changed = {
            field for raw in left.get(key, []) if raw[4:7] in originals
            for field in changed_fields(originals[raw[4:7]], raw)
        }  # fmt: skip
        extra = changed - allowed_fields(unit, name, addressed)
        wrong += [f"{name} {instance}: {sorted(extra)} changed too"] if extra else []
    return wrong


def cases(
    types: Iterable[int], instances: Iterable[int], masks: Iterable[int]
) -> Iterator[tuple[int, float, float]]:
    """Types and addresses, by instance and by bitmask."""
    for kind in types:
        yield from ((kind, float(p3), 0.0) for p3 in instances)
        yield from ((kind, NAN, float(mask)) for mask in masks)


NUMBERS = range(5)  # of instances; the last one does not exist


@pytest.mark.parametrize("unit", UNITS)
def test_a_failure_changes_the_bytes_of_its_unit_and_instances_only(unit: int) -> None:
    # What is addressed does not depend on the type: one type has all addresses.
    first, *others = TYPES
    all_addresses = cases([first], NUMBERS, (0b101, 0b1000))
    for kind, p3, p4 in (*all_addresses, *cases(others, (0, 2), [0b101])):
        assert judge_case(unit, kind, p3, p4) == [], (unit, kind, p3, p4)


@pytest.mark.parametrize("unit", [0, 101])
def test_command_int_says_the_same_as_command_long(unit: int) -> None:
    for kind, p3, p4 in cases([1], (0, 2, 4), (0b101, 0b1000)):
        assert judge_case(unit, kind, p3, p4, as_int=True) == [], (unit, kind, p3, p4)


def test_every_bitmask_addresses_the_instances_of_its_bits() -> None:
    layout = message_layout("COMMAND_LONG")
    for mask in range(1, 0x20000, 1 if __name__ == "__main__" else 41):
        request = FailureRequest.read(Frame(command(0, 1, NAN, mask), layout))
        bits = tuple(n + 1 for n in range(17) if mask >> n & 1)
        assert request.instances == (() if mask == 0xFFFF else bits)


def test_a_failure_that_the_schedule_commands_is_labelled_as_the_autopilot_s() -> None:
    entry = {"id": "native", "fault": "command", "number": 420, "params": [0, 1, 2],
             "afterwards": [0, 0, 2], "for_s": 5}  # fmt: skip
    core = Core(ROLES)
    join_live_control(core, LiveControl(Engine(parse_schedule({"faults": [entry]}))))
    sender = judge.MAVLink(None, 1, 1)
    labels, asked = [], []
    for second in range(12):
        now_us = START_US + second * 1_000_000
        sends = core.received(VEHICLE, heartbeat(), now_us) + core.due(now_us)
        for one in sends:
            message = judge.MAVLink(None).parse_buffer(bytearray(one.data))[0]
            if message.get_type() == "COMMAND_LONG" and one.link == VEHICLE:
                asked.append((message.param1, message.param2, message.param3))
                ack = judge.MAVLink_command_ack_message(420, 0, 0, 0, 1, 191)
                core.received(VEHICLE, bytes(ack.pack(sender)), now_us + 20_000)
        labels += [one for one in core.drain_labels() if one.by]
    assert asked == [(0, 1, 2), (0, 0, 2)]
    (native,) = latest_labels(labels)
    assert (native.id, native.fault, native.by) == ("autopilot1-gyro-2", "gyro-off", "autopilot")
    assert native.end_us is not None
    assert 4_000_000 < native.end_us - native.start_us < 8_000_000


def main() -> int:
    """Try everything; print the number of cases and of what is wrong."""
    test_every_bitmask_addresses_the_instances_of_its_bits()
    count: Counter[str] = Counter()
    forms = [(unit, *case, False) for unit in UNITS for case in cases(TYPES, NUMBERS, WIDE_MASKS)]
    forms += [(unit, *case, True) for unit in UNITS for case in cases([1, 4], NUMBERS, MASKS)]
    for unit, kind, p3, p4, as_int in forms:
        count["cases"] += 1
        for line in judge_case(unit, kind, p3, p4, as_int=as_int):
            count["wrong"] += 1
            print(f"unit {unit}, type {kind}, param 3 {p3}, param 4 {p4}: {line}", flush=True)
    print(f"{count['cases']} cases, {count['wrong']} wrong")
    return bool(count["wrong"])


if __name__ == "__main__":
    sys.exit(main())

from collections.abc import Mapping

from fastcrc.crc16 import mcrf4xx
from hypothesis import given
from hypothesis import strategies as st

from mavproxy_fault.live.control import LiveControl
from mavproxy_fault.proxy.capture_buffer import CaptureBuffer
from mavproxy_fault.proxy.core import Core, LinkRole, Send
from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.proxy.resync_deadline import MAX_BLOCKING_US, MAX_FRAME_US
from mavproxy_fault.proxy.statistics import format_endpoints, link_statistics
from mavproxy_fault.schedule.entries import Schedule, parse_schedule
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame
from mavproxy_fault.wire.parser import Parser
from mavproxy_fault.wire.signing import Signing, derive_key, mask_signing_keys
from tests.signed_frames import sign_frame

SIM, AUTOPILOT, GCS = 0, 1, 2
ROLES = (
    LinkRole("sim", "to-vehicle"),
    LinkRole("autopilot", "from-vehicle"),
    LinkRole("gcs", "to-vehicle"),
)
WALL_US = 1_700_000_000_000_000


def message(
    name: str, *, seq: int = 0, system: int = 1, component: int = 51, **values: object
) -> bytes:
    return build_frame(message_layout(name), values, seq=seq, system=system, component=component)


def sensor(t_s: float, seq: int = 0) -> bytes:
    return message("HIL_SENSOR", seq=seq, time_usec=round(t_s * 1e6), xgyro=0.25, fields_updated=63)


def heartbeat(system: int = 1, component: int = 1, seq: int = 0) -> bytes:
    return message("HEARTBEAT", system=system, component=component, seq=seq, type=2)


def core_with(
    schedule: str, tape: CaptureBuffer | None = None, signing: Signing | None = None
) -> Core:
    engine = Engine(parse_schedule(schedule))
    return Core(ROLES[:2], engine, tape=tape, signing=signing)


def values(sends: list[Send]) -> list[Mapping[str, object]]:
    found = []
    for send in sends:
        for item in Parser().push(send.data, datagram=True):
            assert isinstance(item, Frame)
            found.append({"name": item.layout.name, **item.values()})
    return found


def test_an_untouched_datagram_leaves_unchanged() -> None:
    data = sensor(1.0) + b"noise" + heartbeat(component=51)
    assert Core(ROLES[:2]).received(SIM, data, WALL_US) == [Send(AUTOPILOT, data, WALL_US)]


def test_frames_of_a_stream_leave_one_by_one() -> None:
    roles = (LinkRole("sim", "to-vehicle", datagrams=False), ROLES[1])
    core = Core(roles)
    data = sensor(1.0, 0) + sensor(1.1, 1)
    assert core.received(SIM, data[:30], WALL_US) == []
    assert core.received(SIM, data[30:], WALL_US + 9) == [
        Send(AUTOPILOT, sensor(1.0, 0), WALL_US + 9),
        Send(AUTOPILOT, sensor(1.1, 1), WALL_US + 9),
    ]


def test_streams_of_one_link_do_not_mix() -> None:
    roles = (LinkRole("sim", "to-vehicle", datagrams=False), ROLES[1])
    core = Core(roles)
    core.received(SIM, sensor(1.0)[:30], WALL_US, stream=0)
    assert core.received(SIM, heartbeat(), WALL_US, stream=1)[0].data == heartbeat()
    assert core.received(SIM, sensor(1.0)[30:], WALL_US, stream=0)[0].data == sensor(1.0)


def test_an_incomplete_frame_of_a_stream_is_soon_abandoned() -> None:
    roles = (LinkRole("sim", "to-vehicle", datagrams=False), ROLES[1])
    core = Core(roles)
    assert core.received(SIM, b"\xfd\xff\0\0" + heartbeat(), WALL_US) == []
    due_us = core.next_due_us
    assert due_us is not None
    assert core.due(due_us - 1) == []
    assert b"".join(send.data for send in core.due(due_us)) == b"\xfd\xff\0\0" + heartbeat()


def test_a_foreign_byte_delays_frames_of_a_slow_stream_only_briefly() -> None:
    core = Core((LinkRole("sim", "to-vehicle", datagrams=False), ROLES[1]))
    core.received(SIM, b"\xfd\xff", WALL_US)
    late_us = []
    for n in range(20):
        came_us = WALL_US + n * 250_000  # four per second: the stream is never silent
        left = core.received(SIM, heartbeat(seq=n), came_us)
        while not any(send.data == heartbeat(seq=n) for send in left):
            due_us = core.next_due_us
            assert due_us is not None
            left = core.due(due_us)
            late_us.append(due_us - came_us)
    assert max(late_us) <= MAX_BLOCKING_US


@given(
    st.lists(
        st.tuples(
            st.integers(0, 700_000),
            st.one_of(
                st.just(heartbeat()), st.binary(max_size=9), st.sampled_from([b"\xfd", b"\xfe\xff"])
            ),
        ),
        max_size=60,
    )
)
def test_no_byte_of_a_stream_waits_for_more_than_a_second(chunks: list[tuple[int, bytes]]) -> None:
    core = Core((LinkRole("sim", "to-vehicle", datagrams=False), ROLES[1]))
    now_us, came, left = WALL_US, b"", b""
    came_us: list[int] = []  # of each byte

    def leave(sends: list[Send], when_us: int) -> None:
        nonlocal left
        left += b"".join(send.data for send in sends if send.link == AUTOPILOT)
        assert all(when_us - us <= MAX_FRAME_US for us in came_us[len(left) :])

    for pause_us, data in [*chunks, (2 * MAX_FRAME_US, b"")]:
        now_us += pause_us
        while (due_us := core.next_due_us) is not None and due_us <= now_us:
            leave(core.due(due_us), due_us)
        if data:
            came += data
            came_us += [now_us] * len(data)
            leave(core.received(SIM, data, now_us), now_us)
    assert left == came


def test_a_stream_that_ends_leaves_no_bytes_behind() -> None:
    roles = (LinkRole("sim", "to-vehicle", datagrams=False), ROLES[1])
    core = Core(roles)
    core.received(SIM, sensor(1.0)[:30], WALL_US)
    assert [s.data for s in core.received(SIM, b"", WALL_US)] == [sensor(1.0)[:30]]


def test_a_frame_for_one_component_goes_where_it_was_heard() -> None:
    core = Core(ROLES)
    core.received(AUTOPILOT, heartbeat(1, 1), WALL_US)
    core.received(SIM, heartbeat(1, 51), WALL_US)
    core.received(GCS, heartbeat(255, 190), WALL_US)
    command = message("COMMAND_LONG", system=255, target_system=1, target_component=1, command=400)
    assert [s.link for s in core.received(GCS, command, WALL_US)] == [AUTOPILOT]
    for_all = message("COMMAND_LONG", system=255, target_system=1, command=400)
    assert [s.link for s in core.received(GCS, for_all, WALL_US)] == [SIM, AUTOPILOT]


def test_a_frame_for_an_unknown_target_goes_everywhere() -> None:
    request = message("PARAM_REQUEST_LIST", system=255, target_system=77, target_component=1)
    assert [s.link for s in Core(ROLES).received(GCS, request, WALL_US)] == [SIM, AUTOPILOT]


def test_unknown_bytes_go_to_all_other_links() -> None:
    assert [s.link for s in Core(ROLES).received(AUTOPILOT, b"boot: ok\r\n", WALL_US)] == [SIM, GCS]


def test_a_sender_heard_on_both_sides_is_still_forwarded() -> None:
    core = Core(ROLES[:2])
    for seq in range(5):
        assert core.received(SIM, heartbeat(seq=seq), WALL_US)
        assert core.received(AUTOPILOT, heartbeat(seq=100 + seq), WALL_US)


def test_an_echo_passes_as_often_as_it_was_sent() -> None:
    core = Core(ROLES[:2])
    for _ in range(5):
        assert core.received(SIM, heartbeat(), WALL_US)
        assert core.received(AUTOPILOT, heartbeat(), WALL_US)


def test_a_loop_between_links_dies_out() -> None:
    core = Core(ROLES)
    cable = {AUTOPILOT: GCS, GCS: AUTOPILOT}
    waiting = core.received(SIM, heartbeat(), WALL_US)
    passed = 0
    while waiting:
        send = waiting.pop()
        passed += 1
        assert passed < 20
        if send.link in cable:
            waiting += core.received(cable[send.link], send.data, WALL_US + passed)


def test_gaps_are_counted_per_component() -> None:
    core = Core(ROLES[:2])
    for seq in (250, 251, 255, 0):
        core.received(SIM, heartbeat(1, 51, seq), WALL_US)
    for seq in (3, 4, 5):
        core.received(SIM, heartbeat(1, 1, seq), WALL_US)
    assert core.gaps() == {(1, 51): 3}


def test_a_sender_that_numbers_each_link_separately_has_no_gaps() -> None:
    core = Core(ROLES)
    for seq in range(20):
        core.received(SIM, heartbeat(1, 1, seq), WALL_US)
        core.received(AUTOPILOT, heartbeat(1, 1, 100 + seq // 2), WALL_US)
    assert core.gaps() == {}


def test_a_fault_changes_the_frame_and_writes_its_label_into_the_log() -> None:
    schedule = """
        seed: 1
        faults: [{id: g, fault: bias, target: HIL_SENSOR.xgyro, value: 0.5, at_s: 1, for_s: 1}]"""
    tape = CaptureBuffer()
    core = core_with(schedule, tape)
    seen = []
    for step in range(40):
        seen += values(core.received(SIM, sensor(10 + step / 10, step), WALL_US + step * 100_000))
    rates = [v["xgyro"] for v in seen if v["name"] == "HIL_SENSOR"]
    assert rates == [0.25] * 10 + [0.75] * 10 + [0.25] * 20
    texts = [v["text"] for v in seen if v["name"] == "STATUSTEXT"]
    assert texts == [b"FAULT g on: bias HIL_SENSOR.xgyro", b"FAULT g off: 10 frames"]
    (begun, ended) = core.drain_labels()
    assert (begun.start_us, begun.end_us, ended.end_us) == (11_000_000, None, 12_000_000)
    assert ended.t0_us == 10_000_000


def test_a_delay_is_applied_on_the_wall_clock() -> None:
    schedule = "faults: [{id: d, fault: delay, target: HIL_SENSOR, value: 0.25}]"
    core = core_with(schedule)
    sends = core.received(SIM, sensor(5.0), WALL_US)
    assert [send.link for send in sends] == [SIM]  # the announcement alone
    assert core.next_due_us == WALL_US + 250_000
    assert core.due(WALL_US + 249_999) == []
    assert core.due(WALL_US + 300_000) == [Send(AUTOPILOT, sensor(5.0), WALL_US + 250_000)]
    assert core.next_due_us is None


def test_a_frame_that_is_cut_to_a_few_bytes_does_not_return_to_its_link() -> None:
    core = core_with("faults: [{id: t, fault: truncate, target: HIL_SENSOR, count: 999}]")
    sends = core.received(SIM, sensor(5.0), WALL_US)
    assert [send.link for send in sends if len(send.data) == 1] == [AUTOPILOT]


def leaping() -> bytes:
    """One datagram in which a vehicle's clock starts and jumps by 254 years."""
    stamps = (10**15, (1 << 53) - 10**6, (1 << 53) - 10**6 + 4000)
    return b"".join(message("HIL_GPS", seq=n, time_usec=t) for n, t in enumerate(stamps))


def test_the_labels_that_the_first_stamp_ends_leave_with_it_whatever_follows() -> None:
    tape = CaptureBuffer()
    core = core_with("faults: [{id: b, fault: bias, target: VFR_HUD.alt, value: 1}]", tape)
    core.received(AUTOPILOT, message("VFR_HUD"), WALL_US)
    sends = core.received(AUTOPILOT, leaping(), WALL_US + 1000)
    assert [one["name"] for one in values(sends)] == ["STATUSTEXT", *["HIL_GPS"] * 3]
    assert {send.due_us for send in sends + core.due(WALL_US + 2000)} == {WALL_US + 1000}
    assert len(tape.drain().sent) > 0


def test_a_buffered_fragment_leaves_despite_a_time_jump() -> None:
    tape = CaptureBuffer()
    core = core_with("faults: [{id: s, fault: bias, target: PSEUDORANGE.G12, value: 9}]", tape)
    core.received(AUTOPILOT, message("HIL_GPS", time_usec=10**15), WALL_US)
    first = bytes([1]) + bytes(127)  # of several
    fragment = message("TUNNEL", payload_type=33_845, payload_length=128, payload=first)
    assert core.received(AUTOPILOT, fragment, WALL_US + 1000) == []
    core.received(AUTOPILOT, leaping(), WALL_US + 2000)
    sends = core.due(WALL_US + 3000)
    assert [send.data for send in sends] == [fragment]
    assert 0 <= sends[0].due_us <= WALL_US + 3000


def test_due_frames_leave_before_later_input() -> None:
    schedule = "faults: [{id: d, fault: delay, target: HIL_SENSOR, value: 0.001, for_s: 0.5}]"
    core = core_with(schedule)
    core.received(SIM, sensor(5.0), WALL_US)
    sends = core.received(SIM, heartbeat(component=51), WALL_US + 2_000)
    assert [s.due_us for s in sends] == [WALL_US + 1_000, WALL_US + 2_000]


def test_a_schedule_begun_on_the_wall_clock_restarts_with_the_first_stamp() -> None:
    schedule = "faults: [{id: d, fault: drop, target: HEARTBEAT, at_s: 2}]"
    core = core_with(schedule)
    assert core.received(SIM, heartbeat(), WALL_US)
    assert not values(core.received(SIM, heartbeat(), WALL_US + 3_000_000))[1:]
    core.received(SIM, sensor(7.0), WALL_US + 4_000_000)
    assert "HEARTBEAT" in {
        v["name"] for v in values(core.received(SIM, heartbeat(), WALL_US + 4_000_000))
    }
    core.received(SIM, sensor(9.5), WALL_US + 5_000_000)
    core.received(SIM, heartbeat(), WALL_US + 6_000_000)
    assert [label.t0_us for label in core.drain_labels()] == [WALL_US, WALL_US, 7_000_000]


def test_a_schedule_begun_on_the_uptime_of_a_waiting_autopilot_restarts_with_the_simulator() -> (
    None
):
    schedule = "faults: [{id: d, fault: drop, target: HEARTBEAT, at_s: 2, for_s: 1}]"
    core = core_with(schedule)
    layout = message_layout("ATTITUDE")
    waiting = build_frame(layout, {"time_boot_ms": 11_000_000}, system=1, component=2)
    core.received(AUTOPILOT, waiting, WALL_US)
    core.received(SIM, sensor(0.004), WALL_US + 5_000_000)
    core.received(SIM, sensor(2.5), WALL_US + 8_000_000)
    core.received(SIM, heartbeat(), WALL_US + 8_000_000)
    core.received(SIM, sensor(4.0), WALL_US + 9_000_000)
    core.received(SIM, heartbeat(), WALL_US + 9_000_000)
    begun, ended = core.drain_labels()
    assert (begun.start_us, ended.end_us, ended.frames) == (2_500_000, 3_004_000, 1)


def test_a_station_s_heartbeat_is_answered_for_an_autopilot_that_sends_hil_frames_alone() -> None:
    engine = Engine(Schedule(0, ()))
    core = Core(ROLES, engine, control=LiveControl(engine))
    controls = message_layout("HIL_ACTUATOR_CONTROLS")

    def autopilot(t_s: float) -> None:
        raw = build_frame(controls, {"time_usec": round(t_s * 1e6)})
        core.received(AUTOPILOT, raw, WALL_US + round(t_s * 1e6))

    def answers(t_s: float) -> list[int]:
        beat = build_frame(message_layout("HEARTBEAT"), {"type": 6}, system=255, component=190)
        sends = core.received(GCS, beat, WALL_US + round(t_s * 1e6))
        assert {send.link for send in sends} >= {SIM, AUTOPILOT}, "it is forwarded too"
        found = [Parser().push(send.data)[0] for send in sends if send.link == GCS]
        return [int(one.number("autopilot")) for one in found if isinstance(one, Frame)]

    single = build_frame(message_layout("HEARTBEAT"), {"type": 2, "autopilot": 12})
    core.received(AUTOPILOT, single, WALL_US)
    autopilot(5.0)
    assert answers(5.0) == [12]
    core.received(AUTOPILOT, single, WALL_US + 5_000_000)
    autopilot(6.0)
    assert answers(6.0) == [], "it sends its own"
    autopilot(10.0)
    assert answers(10.0) == [12]
    core.received(SIM, sensor(14.0), WALL_US + 14_000_000)
    assert answers(14.0) == [], "the autopilot has gone"


def test_a_signed_frame_stays_sealed_without_its_key_and_is_signed_again_with_it() -> None:
    key = derive_key("secret")
    schedule = "faults: [{id: g, fault: bias, target: HIL_SENSOR.xgyro, value: 0.5}]"
    frame = sign_frame(Frame(sensor(1.0), message_layout("HIL_SENSOR")), key, 1, 1000)
    (send,) = core_with(schedule).received(SIM, frame.raw, WALL_US)
    assert send.data == frame.raw
    keyed = core_with(schedule, signing=Signing(key))
    changed = next(s for s in keyed.received(SIM, frame.raw, WALL_US) if s.link == AUTOPILOT)
    (item,) = Parser().push(changed.data)
    assert isinstance(item, Frame)
    assert item.number("xgyro") == 0.75
    assert Signing(key).verify(item)
    replayed = keyed.received(SIM, frame.raw, WALL_US)
    assert [s.data for s in replayed] == [frame.raw], "an old stamp is not vouched for"


def test_signatures_are_stripped_on_request() -> None:
    frame = sign_frame(
        Frame(sensor(1.0), message_layout("HIL_SENSOR")), derive_key("secret"), 1, 1000
    )
    core = Core(ROLES[:2], signing=Signing(strip=True))
    assert [s.data for s in core.received(SIM, frame.raw, WALL_US)] == [sensor(1.0)]


def test_the_capture_buffer_stores_received_and_sent_frames() -> None:
    tape = CaptureBuffer()
    core = Core(ROLES[:2], tape=tape)
    core.received(SIM, sensor(1.0) + b"noise", WALL_US)
    taken = tape.drain()
    stamp = WALL_US.to_bytes(8, "big")
    assert taken.received == taken.sent == stamp + sensor(1.0)
    assert taken.received_other == taken.sent_other == stamp + b"\0\0\0\x05noise"
    assert taken.index == bytes((0, 0, len(sensor(1.0)), 0, 0, 0, 0, 1, 5, 0, 0, 0))
    assert tape.drain().received == b""


def test_a_command_reaches_the_vehicle_though_another_sender_has_the_proxys_component() -> None:
    """A bridge beside an autopilot uses component 191, like the proxy's own frames."""
    core = core_with(
        "faults: [{fault: command, number: 218, params: [65, 2], afterwards: [65, 0], for_s: 1}]"
    )
    beside = heartbeat(component=191)
    vehicle = Frame(
        build_frame(message_layout("HEARTBEAT"), {"autopilot": 3, "type": 2}),
        message_layout("HEARTBEAT"),
    ).raw
    granted = build_frame(message_layout("COMMAND_ACK"), {"command": 218, "result": 0})
    heard: list[list[float]] = []
    for now_us, data in ((0, beside), (1000, vehicle), (2000, granted), (2_000_000, beside)):
        for send in core.received(0, data, now_us) + core.due(now_us):
            for item in Parser().push(send.data):
                assert isinstance(item, Frame)
                if send.link == 0 and item.layout.name == "COMMAND_LONG":
                    heard.append([item.number("param1"), item.number("param2")])
    assert heard == [[65, 2], [65, 0]]


def unknown(seq: int, *, system: int = 1, number: int = 52900, extra: int = 77) -> bytes:
    """A frame of a message that no dialect here defines."""
    body = bytes((5, 0, 0, seq, system, 1)) + number.to_bytes(3, "little") + b"hello"
    return b"\xfd" + body + mcrf4xx(body + bytes((extra,))).to_bytes(2, "little")


def test_an_outage_of_a_sender_stops_its_unknown_messages_too() -> None:
    core = core_with("faults: [{fault: outage, where: {system: 1}}]")
    core.received(AUTOPILOT, heartbeat(system=1) + heartbeat(system=2), WALL_US)
    sends = core.received(AUTOPILOT, unknown(1) + unknown(1, system=2), WALL_US + 9)
    assert sends == [Send(SIM, unknown(1, system=2), WALL_US + 9)]


def test_a_sequence_gap_renumbers_unknown_messages_with_their_checksum() -> None:
    core = core_with("faults: [{fault: sequence-gap, value: 1.0}]")
    core.received(AUTOPILOT, heartbeat(seq=4), WALL_US)
    (send,) = core.received(AUTOPILOT, unknown(5), WALL_US + 9)
    assert send.data == unknown(7)  # the heartbeat got 5, and this frame two more than its own


def test_a_fault_of_an_instance_leaves_unknown_messages_alone() -> None:
    core = core_with("faults: [{fault: outage, where: {id: 0}}]")
    core.received(AUTOPILOT, heartbeat(), WALL_US)
    assert core.received(AUTOPILOT, unknown(1), WALL_US) == [Send(SIM, unknown(1), WALL_US)]


def test_a_timestamp_fault_leaves_unknown_messages_alone() -> None:
    core = core_with("faults: [{fault: time-drift, value: 0.5}]")
    core.received(AUTOPILOT, heartbeat(), WALL_US)
    assert core.received(AUTOPILOT, unknown(1), WALL_US) == [Send(SIM, unknown(1), WALL_US)]


def test_unknown_messages_are_no_sequence_gaps() -> None:
    core = Core(ROLES[:2])
    for seq in range(0, 20, 2):
        core.received(AUTOPILOT, heartbeat(seq=seq) + unknown(seq + 1), WALL_US + seq)
    assert core.gaps() == {}


def test_an_unknown_message_alone_introduces_no_sender() -> None:
    core = Core(ROLES)
    core.received(AUTOPILOT, unknown(1, system=7), WALL_US)
    to_seven = message("COMMAND_LONG", system=255, target_system=7, target_component=1)
    assert {send.link for send in core.received(GCS, to_seven, WALL_US)} == {SIM, AUTOPILOT}


def test_the_statistics_name_unknown_messages() -> None:
    core = Core(ROLES[:2])
    for number in (52900, 52901, 52902, 52901, 7777777):
        core.received(AUTOPILOT, unknown(1, number=number), WALL_US)
    statistics = link_statistics(core, AUTOPILOT)
    assert statistics["unknown_ids"] == {"52900": 1, "52901": 2, "52902": 1, "7777777": 1}
    line = format_endpoints([statistics]).splitlines()[-1]
    assert line == "autopilot: 5 frames of unknown messages 52900 to 52902, 7777777"


SECRET = bytes(range(65, 97))


def setup_signing(**target: int) -> bytes:
    values = {"secret_key": SECRET, "initial_timestamp": 12345, **target}
    return message("SETUP_SIGNING", system=255, component=190, **values)


def test_a_signing_key_goes_to_its_target_only() -> None:
    roles = (*ROLES[1:], LinkRole("companion", "to-vehicle"))
    core = Core(roles)
    for link, (system, component) in enumerate([(1, 1), (255, 190), (1, 191)]):
        core.received(link, heartbeat(system=system, component=component), WALL_US)
    for target in ({"target_system": 1}, {"target_system": 1, "target_component": 1}):
        (send,) = core.received(1, setup_signing(**target), WALL_US)
        assert (send.link, send.data) == (0, setup_signing(**target))
    unheard = core.received(1, setup_signing(target_system=7, target_component=1), WALL_US)
    assert [send.link for send in unheard] == [0]
    to_companion = core.received(1, setup_signing(target_system=1, target_component=191), WALL_US)
    assert [send.link for send in to_companion] == [2]


def test_a_signing_key_is_on_no_tape_and_the_masked_tape_gives_the_same_again() -> None:
    corrupt = "{fault: corrupt, value: 0.5, count: 3, where: {system: 255}}"
    faults = f"{corrupt}, {{fault: duplicate, by_s: 0.01}}"
    damaged = bytearray(setup_signing(target_system=1))
    damaged[12] ^= 1
    chunks = [heartbeat(seq=1)]
    chunks += [setup_signing(target_system=1), b"ab" + bytes(damaged), bytes(damaged)[:30]] * 10

    def run(data: list[bytes]) -> tuple[bytes, bytes]:
        tape = CaptureBuffer()
        core = core_with(f"seed: 3\nfaults: [{faults}]", tape)
        for i, chunk in enumerate(data):
            core.received(SIM, chunk, WALL_US + 1000 * i)
        core.finish(WALL_US + 10**6)
        assert SECRET[8:16] not in bytes(tape.received + tape.sent)
        assert SECRET[8:16] not in bytes(tape.received_other + tape.sent_other)
        return bytes(tape.sent), bytes(tape.sent_other)

    assert run([mask_signing_keys(chunk) for chunk in chunks]) == run(chunks)

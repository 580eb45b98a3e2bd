import itertools
import random
import warnings
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavproxy_fault.wire import parser
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame
from mavproxy_fault.wire.parser import Junk, Parser

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    from pymavlink.dialects.v10 import all as mavlink1
    from pymavlink.dialects.v20 import all as mavlink2

KEY = bytes(range(32))


def judge(dialect: Any, *, sign: bool = False) -> Any:
    link = dialect.MAVLink(None, srcSystem=1, srcComponent=51)
    link.signing.sign_outgoing = sign
    link.signing.secret_key = KEY
    link.signing.timestamp = 10**9
    return link


def pymavlink_frames() -> dict[str, bytes]:
    """One frame of each kind, made by pymavlink."""
    imu = (1234567, *(0.1 * i for i in range(13)), 0x1FFF)
    cut = mavlink2.MAVLink_hil_gps_message(1, 3, 4, 5, 6, 7, 8, 0, 0, 0, 0, 0, 0)
    extended = mavlink2.MAVLink_hil_sensor_message(*imu, id=2)
    plain = judge(mavlink2)
    return {
        "v2": mavlink2.MAVLink_hil_sensor_message(*imu).pack(plain),
        "v2 zeros cut": cut.pack(plain),
        "v2 extended": extended.pack(plain),
        "v2 signed": extended.pack(judge(mavlink2, sign=True)),
        "v1": mavlink1.MAVLink_heartbeat_message(2, 3, 81, 0, 4, 3).pack(judge(mavlink1)),
    }


FRAMES = pymavlink_frames()
HEARTBEAT = build_frame(
    message_layout("HEARTBEAT"), {"type": 2, "autopilot": 12, "mavlink_version": 3}, seq=9
)


def unknown_frame(payload: bytes = b"payload", number: int = 0xABCDE) -> bytes:
    """A well-formed frame of a message that is in no dialect."""
    body = bytes((len(payload), 0, 0, 7, 1, 1)) + number.to_bytes(3, "little") + payload
    crc = mavlink2.x25crc(body + b"\x55").crc
    return b"\xfd" + body + crc.to_bytes(2, "little")


def joined(items: list[Frame | Junk]) -> bytes:
    return b"".join(item.raw for item in items)


def shape(items: list[Frame | Junk]) -> list[str]:
    return [item.layout.name if isinstance(item, Frame) else item.kind for item in items]


@pytest.mark.parametrize("name", FRAMES)
def test_each_kind_of_frame_is_recognised_and_kept_unchanged(name: str) -> None:
    (frame,) = Parser().push(FRAMES[name])
    assert isinstance(frame, Frame)
    assert frame.raw == FRAMES[name]
    assert (frame.system, frame.component) == (1, 51)
    assert frame.signed == (name == "v2 signed")


@pytest.mark.parametrize("name", FRAMES)
def test_a_broken_frame_does_not_swallow_the_next_one(name: str) -> None:
    broken = bytearray(FRAMES[name])
    broken[12] ^= 0x40
    items = Parser().push(bytes(broken) + HEARTBEAT, datagram=True)
    assert joined(items) == bytes(broken) + HEARTBEAT
    assert shape(items)[-1] == "HEARTBEAT"
    assert "crc" in shape(items)


def test_a_length_too_large_does_not_swallow_the_next_frame() -> None:
    broken = bytearray(HEARTBEAT)
    broken[1] = 255
    parser = Parser()
    items = parser.push(bytes(broken) + HEARTBEAT * 3, datagram=True)
    assert shape(items) == ["foreign", "HEARTBEAT", "HEARTBEAT", "HEARTBEAT"]
    assert parser.incomplete == 0


def test_an_unknown_message_passes_in_one_piece() -> None:
    parser = Parser()
    items = parser.push(HEARTBEAT + unknown_frame() + HEARTBEAT)
    assert shape(items) == ["HEARTBEAT", "unknown", "HEARTBEAT"]
    assert items[1].raw == unknown_frame()
    assert parser.counters.unknown == 1


def test_an_unknown_message_with_a_frame_inside_does_not_hide_it() -> None:
    items = Parser().push(unknown_frame(HEARTBEAT))
    assert "HEARTBEAT" in shape(items)
    assert joined(items) == unknown_frame(HEARTBEAT)


def test_a_start_byte_in_foreign_text_does_not_hide_the_next_frame() -> None:
    for seed in range(200):
        noise = b"\xfd" + random.Random(seed).randbytes(30)
        parser = Parser()
        items = parser.push(noise + HEARTBEAT * 12) + parser.release()
        assert shape(items).count("HEARTBEAT") == 12, noise.hex()


def test_a_frame_with_an_unknown_flag_passes_without_faults() -> None:
    raw = bytearray(HEARTBEAT[:-2])
    raw[2] = 0x02
    raw += mavlink2.x25crc(
        bytes(raw[1:]) + bytes((message_layout("HEARTBEAT").crc_extra,))
    ).crc.to_bytes(2, "little")
    assert shape(Parser().push(bytes(raw) + HEARTBEAT)) == ["unknown", "HEARTBEAT"]


def test_a_payload_longer_than_the_layout_is_kept() -> None:
    frame = Frame(HEARTBEAT, message_layout("HEARTBEAT")).with_payload(
        b"\1\2\3\4\5\6\7\x08\x09\x0a\x0b"
    )
    (item,) = Parser().push(frame.raw)
    assert isinstance(item, Frame)
    assert item.raw == frame.raw


def test_an_incomplete_frame_waits_in_a_stream_but_not_in_a_datagram() -> None:
    parser = Parser()
    assert parser.push(HEARTBEAT[:11]) == []
    assert parser.incomplete == 11
    assert shape(parser.push(HEARTBEAT[11:])) == ["HEARTBEAT"]
    assert shape(parser.push(HEARTBEAT[:11], datagram=True)) == ["foreign"]


def test_release_abandons_an_incomplete_frame_and_finds_the_frames_in_it() -> None:
    parser = Parser()
    assert parser.push(b"\xfd\xff\0\0" + HEARTBEAT) == []
    assert shape(parser.release()) == ["foreign", "HEARTBEAT"]
    assert parser.incomplete == 0


def test_resync_keeps_the_next_incomplete_frame() -> None:
    parser = Parser()
    assert parser.push(b"\xfd\xff\0\0" + HEARTBEAT + FRAMES["v2"][:30]) == []
    assert parser.contains_frame
    assert shape(parser.resync()) == ["foreign", "HEARTBEAT"]
    assert parser.incomplete == 30
    assert not parser.contains_frame
    assert shape(parser.push(FRAMES["v2"][30:])) == [shape(Parser().push(FRAMES["v2"]))[0]]


PIECES = st.one_of(
    st.sampled_from(sorted(FRAMES.values())),
    st.just(unknown_frame()),
    st.binary(max_size=40),
    st.sampled_from([b"\xfd", b"\xfe", b"\xfd\xff", HEARTBEAT[:-1], FRAMES["v2"][:30]]),
)


@given(st.lists(PIECES, max_size=12), st.lists(st.integers(0, 400), max_size=12))
def test_any_chunking_loses_no_byte_and_finds_the_same_frames(
    pieces: list[bytes], cuts: list[int]
) -> None:
    data = b"".join(pieces)
    edges = [0, *sorted(min(cut, len(data)) for cut in cuts), len(data)]
    parser = Parser()
    items = []
    for start, end in itertools.pairwise(edges):
        items += parser.push(data[start:end])
    items += parser.release()
    assert joined(items) == data
    reference = Parser()
    expected = reference.push(data) + reference.release()
    assert [i.raw for i in items if isinstance(i, Frame)] == [
        i.raw for i in expected if isinstance(i, Frame)
    ]


@given(st.lists(PIECES, max_size=12))
def test_pymavlink_finds_no_other_frame_in_clean_traffic(pieces: list[bytes]) -> None:
    clean = [p for p in pieces if p in FRAMES.values()]
    link = mavlink2.MAVLink(None)
    link.robust_parsing = True
    data = b"".join(clean)
    theirs = [bytes(m.get_msgbuf()) for m in link.parse_buffer(data) or []]
    assert [item.raw for item in Parser().push(data)] == theirs


def test_bytes_that_all_look_like_a_frame_start_take_linear_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # Crafted input can have a possible CRC at every start; here every CRC is accepted.
    monkeypatch.setattr(parser, "_crc_extra_of", lambda body, crc: 0)
    looked = []
    read = parser.whole_frame
    monkeypatch.setattr(parser, "whole_frame", lambda *place: looked.append(place) or read(*place))
    heartbeat = build_frame(message_layout("HEARTBEAT"), {"type": 1})
    data = (b"\xfd" * 240 + heartbeat) * 20
    found = Parser().push(data, datagram=True)
    assert b"".join(item.raw for item in found) == data
    assert [item.raw for item in found if isinstance(item, Frame)] == [heartbeat] * 20
    assert len(looked) < 5 * len(data)

"""RTCM framing and transport in TUNNEL, checked with pymavlink and pyrtcm."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as mavlink
from pyrtcm import calc_crc24q

from mavproxy_fault.fault_parts.elements import locate_element, patch_frame
from mavproxy_fault.rtcm.msm7 import encode_epoch
from mavproxy_fault.rtcm.transport import (
    FRAGMENT_BYTES,
    MESSAGE_MAX,
    PAYLOAD_TYPE,
    SENDERS_MAX,
    Reassembler,
    crc24q,
    message_number,
    split_fragments,
    split_messages,
    tunnel_frames,
    tunnel_payload,
    unwrap_message,
    wrap_message,
)
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame

# RTCM 10403.3 section 4.3: the standard's example of a complete message (1005)
EXAMPLE = bytes.fromhex("D300133ED7D30202980EDEEF34B4BD62AC0941986F33360B98")


def message_of(length: int) -> bytes:
    return wrap_message(bytes(range(256))[: length - 6] + bytes(max(length - 262, 0)))


def test_the_example_of_the_standard_has_a_valid_crc() -> None:
    assert crc24q(EXAMPLE[:-3]) == int.from_bytes(EXAMPLE[-3:], "big")
    assert wrap_message(unwrap_message(EXAMPLE)) == EXAMPLE
    assert message_number(EXAMPLE) == 1005


@given(st.binary(min_size=2, max_size=300))
def test_pyrtcm_accepts_our_crc(body: bytes) -> None:
    message = wrap_message(body)
    assert calc_crc24q(message) == 0
    assert unwrap_message(message) == body


def test_a_flipped_bit_fails_the_crc() -> None:
    broken = EXAMPLE[:8] + bytes((EXAMPLE[8] ^ 4,)) + EXAMPLE[9:]
    with pytest.raises(ValueError, match="CRC"):
        unwrap_message(broken)
    assert list(split_messages(broken)) == []


def test_a_body_that_does_not_fit_ten_bits_is_refused() -> None:
    with pytest.raises(ValueError, match="1023"):
        wrap_message(bytes(1024))


def test_other_bytes_between_messages_are_skipped() -> None:
    noise = b"\xd3\x00\x05xyz\xd3"
    assert list(split_messages(noise + EXAMPLE + noise + EXAMPLE + EXAMPLE[:9])) == [EXAMPLE] * 2


@pytest.mark.parametrize(
    ("length", "sizes"),
    [
        (8, [8]),
        (127, [127]),
        (128, [127, 1]),
        (253, [127, 126]),
        (254, [127, 127, 0]),
        (381, [127, 127, 127, 0]),
        (382, [127, 127, 127, 1]),
        (508, [127, 127, 127, 127]),
    ],
)
def test_a_message_is_fragmented_like_gps_rtcm_data(length: int, sizes: list[int]) -> None:
    payloads = split_fragments(message_of(length), 37)
    assert [len(p) - 1 for p in payloads] == sizes
    assert [p[0] & 1 for p in payloads] == [int(len(sizes) > 1)] * len(sizes)
    assert [p[0] >> 1 & 3 for p in payloads] == list(range(len(sizes)))
    assert {p[0] >> 3 for p in payloads} == {37 % 32}


@pytest.mark.parametrize("length", [8, 127, 128, 254, 381, 400, 508])
def test_fragments_in_any_order_are_reassembled(length: int) -> None:
    message = message_of(length)
    for order in (1, -1):
        box = Reassembler()
        found = [m for payload in split_fragments(message, 3)[::order] for m in box.add(payload)]
        assert found == [message]


def test_a_message_longer_than_four_fragments_is_refused() -> None:
    with pytest.raises(ValueError, match="508"):
        split_fragments(message_of(MESSAGE_MAX + 1), 0)


def test_a_lost_fragment_loses_only_its_message() -> None:
    first, second = message_of(200), message_of(300)
    box = Reassembler()
    assert box.add(split_fragments(first, 0)[0]) == []
    assert [m for p in split_fragments(second, 1) for m in box.add(p)] == [second]


def test_interleaved_messages_are_kept_apart() -> None:
    first, second = message_of(200), message_of(201)
    pairs = zip(split_fragments(first, 0), split_fragments(second, 1), strict=True)
    box = Reassembler()
    assert [m for pair in pairs for p in pair for m in box.add(p)] == [first, second]


def test_old_fragments_of_a_sequence_number_do_not_mix_with_new_ones() -> None:
    old, new = split_fragments(message_of(300), 0), split_fragments(message_of(310), 32)
    box = Reassembler()
    box.add(old[1])
    for sequence in range(1, 32):
        box.add(split_fragments(message_of(200), sequence)[0])
    assert box.add(new[0]) == []
    assert box.add(new[2]) == []
    assert box.add(new[1]) == [message_of(310)]


@given(st.lists(st.tuples(st.binary(max_size=FRAGMENT_BYTES + 1), st.integers(0, 40)), max_size=80))
def test_no_garbage_breaks_the_reassembler(payloads: list[tuple[bytes, int]]) -> None:
    box, of_one = Reassembler(), Reassembler()
    for payload, sender in payloads:
        box.add(payload, sender)
        of_one.add(payload)
    assert len(box._pending) <= SENDERS_MAX * 4
    assert len(of_one._pending) <= 4


def test_the_fragments_of_several_senders_are_kept_apart() -> None:
    message = message_of(300)
    parts = [(part, n) for part in split_fragments(message, 1) for n in range(SENDERS_MAX)]
    box = Reassembler()
    assert [m for part, n in parts for m in box.add(part, n)] == [message] * SENDERS_MAX


def test_pymavlink_reads_the_tunnel_frames() -> None:
    message = message_of(300)
    parser = mavlink.MAVLink(None)
    box = Reassembler()
    found = []
    for number, raw in enumerate(tunnel_frames(message, 5, seq=254, system=1, component=51)):
        decoded = parser.parse_char(raw)
        assert decoded.get_type() == "TUNNEL"
        assert decoded.payload_type == PAYLOAD_TYPE > 32767
        assert decoded.get_seq() == (254 + number) % 256
        assert (decoded.get_srcSystem(), decoded.get_srcComponent()) == (1, 51)
        found += box.add(bytes(decoded.payload[: decoded.payload_length]))
    assert found == [message]


def test_a_tunnel_payload_that_ends_with_zeros_is_restored() -> None:
    message = wrap_message(b"\x43\x50" + bytes(20))
    payloads = [
        tunnel_payload(Frame(raw, message_layout("TUNNEL"))) for raw in tunnel_frames(message, 0)
    ]
    assert payloads == split_fragments(message, 0)
    (raw,) = tunnel_frames(wrap_message(bytes(60))[:-3] + bytes(3), 0)
    payload = tunnel_payload(Frame(raw, message_layout("TUNNEL")))
    assert payload is not None
    assert len(payload) == 1 + 66


def test_another_tunnel_payload_type_is_ignored() -> None:
    frame = Frame(tunnel_frames(EXAMPLE, 0)[0], message_layout("TUNNEL"))
    kind = locate_element(frame.layout, "payload_type")
    assert tunnel_payload(patch_frame(frame, {kind: 200})) is None


def test_twelve_satellites_of_two_systems_fit_two_frames_each() -> None:
    names = [f"G{i:02d}" for i in range(1, 13)] + [f"E{i:02d}" for i in range(1, 13)]
    messages = encode_epoch(1.0, names, [2.2e7] * 24, [100.0] * 24, [45.0] * 24)
    assert [len(split_fragments(m, 0)) for m in messages] == [2, 2]

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavproxy_fault.ardupilot.feeding.vectornav_handshake import (
    Handshake,
    format_sentence,
    xor_checksum,
)
from mavproxy_fault.documents.errors import ConfigError


def test_a_real_driver_is_answered_line_for_line(handshake_lines):
    handshake = Handshake()
    answers = [handshake.received(line) for line in handshake_lines]
    assert {output.pace for output in handshake.outputs} >= {"imu", "gnss"}
    echoed = [line for line in handshake_lines if b"VNRRG" not in line]
    assert [answer for answer in answers if b"VNRRG" not in answer] == echoed
    assert b"$VNRRG,01,VN-200*%02X\r\n" % xor_checksum(b"VNRRG,01,VN-200") in answers


def test_nothing_streams_before_the_driver_has_configured_it(handshake_lines):
    handshake = Handshake()
    for line in handshake_lines:
        if b"VNWRG,75" in line:
            break
        handshake.received(line)
        assert not handshake.outputs


@given(st.data())
def test_any_chunking_gives_the_same_answers(handshake_lines, data):
    data_bytes = b"".join(handshake_lines)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(data_bytes)), max_size=8)))
    ends = [0, *cuts, len(data_bytes)]
    handshake = Handshake()
    answers = b"".join(handshake.received(data_bytes[a:b]) for a, b in pairwise(ends))
    assert answers == Handshake().received(data_bytes)


def test_a_corrupted_line_is_not_answered():
    assert Handshake().received(b"$VNASY,1*00\r\n") == b""
    assert Handshake().received(b"VNASY,1\r\n") == b""
    assert Handshake().received(b"\r\n") == b""


def test_a_pause_stops_the_stream():
    handshake = Handshake()
    handshake.received(format_sentence(b"VNWRG,75,3,2,01,0721"))
    assert len(handshake.outputs) == 1
    handshake.received(format_sentence(b"VNASY,0"))
    assert not handshake.outputs
    handshake.received(format_sentence(b"VNASY,1"))
    assert len(handshake.outputs) == 1


def test_an_unsupported_output_is_reported():
    with pytest.raises(ConfigError, match="field 3 of group 1"):
        Handshake().received(format_sentence(b"VNWRG,75,3,2,01,0008"))


def test_invalid_numbers_are_not_answered():
    handshake = Handshake()
    for body in (b"VNRRG,x", b"VNWRG,75,3,2,zz,0721", b"VNWRG,x,3,2,01,0721"):
        assert handshake.received(format_sentence(body)) == b""
    assert not handshake.outputs


def test_an_endless_line_does_not_grow_without_bound():
    handshake = Handshake()
    for _ in range(100):
        handshake.received(b"x" * 1000)
    assert handshake.received(b"\n" + format_sentence(b"VNASY,1")) == format_sentence(b"VNASY,1")

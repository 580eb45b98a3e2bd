from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from mavproxy_fault.ardupilot.feeding.vectornav_handshake import Handshake, checksum, sentence_of


def test_a_real_driver_is_answered_line_for_line(handshake_lines):
    handshake = Handshake()
    answers = [handshake.received(line) for line in handshake_lines]
    assert handshake.streaming
    echoed = [line for line in handshake_lines if b"VNRRG" not in line]
    assert [answer for answer in answers if b"VNRRG" not in answer] == echoed
    assert b"$VNRRG,01,VN-200*%02X\r\n" % checksum(b"VNRRG,01,VN-200") in answers


def test_nothing_streams_before_the_driver_asks_for_it(handshake_lines):
    handshake = Handshake()
    for line in handshake_lines[:-1]:
        handshake.received(line)
        assert not handshake.streaming


@given(st.data())
def test_any_chunking_gives_the_same_answers(handshake_lines, data):
    whole = b"".join(handshake_lines)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(whole)), max_size=8)))
    ends = [0, *cuts, len(whole)]
    handshake = Handshake()
    answers = b"".join(handshake.received(whole[a:b]) for a, b in pairwise(ends))
    assert answers == Handshake().received(whole)


def test_a_damaged_line_is_not_answered():
    assert Handshake().received(b"$VNASY,1*00\r\n") == b""
    assert Handshake().received(b"VNASY,1\r\n") == b""
    assert Handshake().received(b"\r\n") == b""


def test_a_pause_stops_the_stream():
    handshake = Handshake()
    handshake.received(sentence_of(b"VNASY,1"))
    handshake.received(sentence_of(b"VNASY,0"))
    assert not handshake.streaming


def test_a_line_without_end_does_not_grow_for_ever():
    handshake = Handshake()
    for _ in range(100):
        handshake.received(b"x" * 1000)
    assert handshake.received(b"\n" + sentence_of(b"VNASY,1")) == sentence_of(b"VNASY,1")

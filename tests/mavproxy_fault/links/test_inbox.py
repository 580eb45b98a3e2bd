from contextlib import closing

from mavproxy_fault.links.inbox import Inbox
from mavproxy_fault.links.link import Chunk
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import build_frame

HEARTBEAT = message_layout("HEARTBEAT")


class Script:
    """A link that returns prepared chunks."""

    datagrams = False

    def __init__(self, *reads: list[Chunk]) -> None:
        self.reads = list(reads)

    def read(self) -> list[Chunk]:
        return self.reads.pop(0) if self.reads else []

    def close(self) -> None: ...


def frames(*reads: list[Chunk]) -> list[int]:
    with closing(Script(*reads)) as link:
        inbox = Inbox(link)  # type: ignore[arg-type]
        return [frame.seq for _ in range(len(reads)) for frame in inbox.frames()]


def beat(seq: int) -> bytes:
    return build_frame(HEARTBEAT, {"type": 6}, seq=seq)


def test_a_frame_split_across_reads_is_complete() -> None:
    assert frames([(0, beat(1)[:7])], [(0, beat(1)[7:] + beat(2))]) == [1, 2]


def test_streams_do_not_mix() -> None:
    assert frames([(0, beat(1)[:7]), (1, beat(2))], [(0, beat(1)[7:])]) == [2, 1]


def test_an_incomplete_frame_of_a_closed_stream_is_discarded() -> None:
    assert frames([(0, beat(1)[:7]), (0, b"")], [(0, beat(2))]) == [2]


def test_junk_is_left_out() -> None:
    assert frames([(0, b"hello" + beat(1) + b"\xfd\x01")]) == [1]

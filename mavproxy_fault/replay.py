"""Replay: a tlog through the proxy's core, to another tlog or in real time to a link.

A `received.tlog` of the proxy, with its index and session beside it, the same schedule and the
same seed gives `sent.tlog` again byte for byte.
"""

import argparse
import select
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from mavproxy_fault.core import Core
from mavproxy_fault.engine import Engine
from mavproxy_fault.errors import ConfigError
from mavproxy_fault.links.link import Link
from mavproxy_fault.links.spec import open_link
from mavproxy_fault.playback import Source, open_log
from mavproxy_fault.ports import Send
from mavproxy_fault.record import encoded
from mavproxy_fault.schedule import read_schedule
from mavproxy_fault.tape import Tape

FLUSH_BYTES = 1 << 20
TEND_S = 0.1


def play(source: Source, engine: Engine, tape: Tape) -> Iterator[tuple[Core, list[Send]]]:
    """Push a log through a core, a step per record, then let everything delayed leave."""
    core = Core(source.roles, engine, tape=tape)
    newest_us = 0
    for record in source.records:
        newest_us = max(newest_us, record.t_us)
        yield core, core.received(record.link, record.raw, record.t_us)
    if source.end_us is None:
        while core.next_due_us is not None:
            newest_us = max(newest_us, core.next_due_us)
            yield core, core.due(newest_us)
    yield core, core.finish(source.end_us or newest_us)


def to_log(source: Source, engine: Engine, out: Path) -> Path:
    """Write what is sent to a tlog and the labels beside it, as `NAME.labels.jsonl`."""
    tape = Tape()
    labels_path = out.with_suffix(".labels.jsonl")
    with out.open("wb") as log, labels_path.open("wb") as labels:
        for core, _ in play(source, engine, tape):
            if len(tape.sent) >= FLUSH_BYTES:
                log.write(tape.take().sent)
            labels.write(encoded(core.take_labels()))
        log.write(tape.take().sent)
    return labels_path


def to_link(
    source: Source,
    engine: Engine,
    link: Link,
    clock: Callable[[], float] = time.monotonic,
) -> int:
    """Send at the pace of the log; gives the number of frames or datagrams sent.

    A server waits for its first peer.
    """
    while not link.peer_count:
        _pause(link, TEND_S)
    core = Core(source.roles, engine)
    start_s, first_us, sent = clock(), -1, 0

    def wait_for(t_us: int) -> None:
        while (rest_s := start_s + (t_us - first_us) * 1e-6 - clock()) > 0:
            _pause(link, min(rest_s, TEND_S))

    def write(sends: list[Send]) -> int:
        for send in sends:
            wait_for(send.due_us)
            link.write(send.data)
        return len(sends)

    for record in source.records:
        first_us = record.t_us if first_us < 0 else first_us
        while (due_us := core.next_due_us) is not None and due_us <= record.t_us:
            sent += write(core.due(due_us))
        wait_for(record.t_us)
        sent += write(core.received(record.link, record.raw, record.t_us))
    while (due_us := core.next_due_us) is not None:
        sent += write(core.due(due_us))
    return sent


def _pause(link: Link, wait_s: float) -> None:
    """Wait, and drain what the peer sends meanwhile."""
    select.select([link], (), (), wait_s)
    link.read()


def main(args: argparse.Namespace) -> int:
    """`mavproxy-fault replay`."""
    engine = Engine(read_schedule(args.schedule))
    path = Path(args.log)
    source = open_log(path)
    if args.out:
        out = Path(args.out)
        if out.exists() and out.samefile(path):
            raise ConfigError(f"{out}: is the log that is replayed; allowed: another file")
        out.parent.mkdir(parents=True, exist_ok=True)
        labels = to_log(source, engine, out)
        print(f"{out}\n{labels}")
        return 0
    link = open_link(args.link, plain_udp="udpout")
    try:
        print(f"{to_link(source, engine, link)} sent to {link.name}")
    finally:
        link.close()
    return 0

"""The `proxy` command: builds links, core, recorder and live control, and runs the server."""

import argparse
import contextlib
import gc
import ipaddress
import logging
import os
import signal
import socket
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Any

from mavproxy_fault.app.command_result import print_result
from mavproxy_fault.app.recorder import Recorder
from mavproxy_fault.app.resource_check import check_resources
from mavproxy_fault.app.server import Server
from mavproxy_fault.documents.errors import ConfigError, users_path
from mavproxy_fault.links.bus import check_run_name
from mavproxy_fault.links.link import Link
from mavproxy_fault.links.peers import Admission
from mavproxy_fault.links.spec import open_link
from mavproxy_fault.links.udp import UdpServer
from mavproxy_fault.proxy.capture_buffer import CaptureBuffer
from mavproxy_fault.proxy.core import Core
from mavproxy_fault.proxy.interfaces import LinkRole
from mavproxy_fault.proxy.statistics import format_endpoints
from mavproxy_fault.wire.dialect import message_names
from mavproxy_fault.wire.parser import begins_with_frame
from mavproxy_fault.wire.signing import Signing, derive_key

if TYPE_CHECKING:
    from mavproxy_fault.live.session import LiveSession
    from mavproxy_fault.proxy.engine import Engine

LOG = logging.getLogger(__name__)
MOST_KEY_CHARACTERS = 1 << 16  # characters of a passphrase


def open_links(master: str, outs: Sequence[str]) -> list[Link]:
    """Open the vehicle's link and the others; close all if one fails."""
    links: list[Link] = []
    try:
        links.append(open_link(master, bare_udp="udpin"))
        links += [open_link(out, bare_udp="udpout") for out in outs]
    # Errors of links are ValueErrors, among them `ConfigError`.
    except ValueError:
        for link in links:
            link.close()
        raise
    return links


def set_admission(links: Sequence[Link], allowed: Sequence[str], *, lock: bool) -> None:
    """Restrict listening UDP links to the peers allowed by the command line.

    Raises
    ------
    ConfigError
        If one of `allowed` is not an address or network.
    """
    try:
        networks = tuple(ipaddress.ip_network(text) for text in allowed)
    except ValueError as error:
        raise ConfigError(
            f"--allow-peer: {error}; give an address or network such as 192.168.1.0/24"
        ) from None
    for link in links:
        if isinstance(link, UdpServer):
            link.peers.admission = Admission(networks, lock, begins_with_frame)


def link_roles(links: Sequence[Link]) -> list[LinkRole]:
    """Return the role of each link; the first link is the vehicle's."""
    return [
        LinkRole(link.name, "to-vehicle" if number else "from-vehicle", link.datagrams)
        for number, link in enumerate(links)
    ]


def make_server(
    links: Sequence[Link],
    engine: "Engine | None",
    logdir: str | Path | None,
    session: dict[str, Any],
    signing: Signing | None = None,
    busy_poll: bool = False,
) -> Server:
    """Return the server of links; with a folder it records `session`, what a replay needs."""
    tape = CaptureBuffer() if logdir else None
    core = Core(link_roles(links), engine, signing=signing, tape=tape)
    session["links"] = [{"name": role.name, "direction": role.direction} for role in core.links]
    recorder = Recorder(Path(logdir), session) if logdir else None
    return Server(links, core, tape=tape, recorder=recorder, busy_poll=busy_poll)


@contextlib.contextmanager
def stop_on_signals(server: Server) -> Iterator[socket.socket]:
    """Stop the server on SIGINT or SIGTERM; yields the socket that wakes it."""
    wake, woken = socket.socketpair()
    woken.setblocking(False)
    names = (signal.SIGINT, signal.SIGTERM)
    # The handler only sets a flag; the wake-up descriptor ends the wait.
    before = [signal.signal(name, lambda *_: server.stop()) for name in names]
    # A full buffer is harmless: one byte is enough.
    descriptor = signal.set_wakeup_fd(woken.fileno(), warn_on_full_buffer=False)
    try:
        yield wake
    finally:
        signal.set_wakeup_fd(descriptor)
        for name, action in zip(names, before, strict=True):
            signal.signal(name, action)
        wake.close()
        woken.close()


def read_signing(args: argparse.Namespace) -> Signing | None:
    """Return the handling of signed frames given by the options.

    Raises
    ------
    ConfigError
        If the key file cannot be read.
    """
    if args.signing_key is None:
        return Signing(strip=True) if args.strip_signatures else None
    where = f"{args.signing_key}: cannot be read"
    with users_path(where, "give a file with the passphrase"), open(args.signing_key) as file:
        phrase = file.read(MOST_KEY_CHARACTERS).strip()  # a device file may be endless
    return Signing(derive_key(phrase), strip=args.strip_signatures)


def open_live(args: argparse.Namespace, engine: "Engine | None", server: Server) -> "LiveSession":
    """Open live control over Zenoh and RflySim's port; imports numpy and all faults."""
    check_resources()
    # Imported here, in the background thread.
    # Without the threads of its linear algebra, which a proxy does not need.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    import numpy.random  # noqa: F401  or the first draw of a live fault would delay a frame

    import mavproxy_fault.compiled.plans  # noqa: F401  or a later frame would wait for it
    from mavproxy_fault.live.control import LiveControl
    from mavproxy_fault.live.edit_log import EditLog
    from mavproxy_fault.live.rflysim import DEFAULT_MAP, read_map
    from mavproxy_fault.live.session import LiveSession
    from mavproxy_fault.proxy.engine import Engine, refuse_commands
    from mavproxy_fault.schedule.entries import Schedule

    rflysim = read_map(args.rflysim_map or DEFAULT_MAP) if args.rflysim is not None else None
    control = LiveControl(
        engine or Engine(Schedule(0, ()), check=None if args.allow_commands else refuse_commands),
        allowed=args.inject,
        rflysim=rflysim,
        # Series files are read only from the folders given by --files.
        folders=[Path(one) for one in args.files],
    )
    live = LiveSession(control, server.edit_time, EditLog(server.core, server.tape))
    if args.rflysim is not None:
        live.open_rflysim(args.rflysim)
    live.open_bus(args.zenoh, args.run, args.zenoh_config)
    return live


def start_live(args: argparse.Namespace, engine: "Engine | None", server: Server) -> None:
    """Open live control in a background thread."""
    try:
        from concurrent.futures import Future

        from mavproxy_fault.live.session import short_thread_turns
    except OSError as error:  # no descriptor is left for the import
        LOG.error("no live control, forwarding continues: %s", error)
        return
    coming: Future[LiveSession] = Future()

    def work() -> None:
        try:
            with short_thread_turns():
                coming.set_result(open_live(args, engine, server))
        # Passed to the loop, which would otherwise wait forever; a panic in Zenoh is not an
        # Exception.
        except BaseException as error:
            coming.set_exception(error)

    server.opening_live = coming
    try:
        Thread(target=work).start()  # not a daemon: outliving the interpreter would abort
    except RuntimeError as error:  # the system refuses another thread
        coming.set_exception(error)


def make_engine(args: argparse.Namespace) -> "Engine | None":
    """The engine of `--schedule`; None without."""
    if not args.schedule:
        return None
    from mavproxy_fault.proxy.engine import Engine, refuse_commands
    from mavproxy_fault.schedule.entries import read_schedule

    refuse = None if args.allow_commands else refuse_commands
    engine = Engine(read_schedule(args.schedule), check=refuse)
    if engine.draws:  # or the first random draw would delay a frame
        import numpy.random  # noqa: F401
    return engine


def main(args: argparse.Namespace) -> int:
    """`mavproxy-fault proxy`."""
    # Arguments are checked before any socket is opened.
    if args.run is not None:
        check_run_name(args.run)
    for folder in args.files:
        if not Path(folder).is_dir():
            raise ConfigError(f"--files {folder}: is not a folder; give one with series files")
    # `session.json` stores what a replay needs.
    session: dict[str, Any] = {"seed": None, "schedule": None, "inject": args.inject}
    engine = make_engine(args)
    if engine is not None:
        session |= {"seed": engine.seed, "schedule": Path(args.schedule).read_text()}
    if args.rflysim_map and args.rflysim is None:
        raise ConfigError("--rflysim-map: has no effect without --rflysim PORT; give that too")
    signed = read_signing(args)
    # Links first: a port in use ends the command before any file is written.
    links = open_links(args.master, args.to)
    try:
        set_admission(links, args.allow_peer, lock=args.lock_peer)
        if args.rflysim is not None and args.rflysim_map:
            session["rflysim_map"] = str(Path(args.rflysim_map).resolve())
        server = make_server(links, engine, args.logdir, session, signed, args.busy_poll)
        server.prepare()
        message_names()  # loads the table, for which no descriptor may be left later
        by_name = args.zenoh not in ("auto", "off") or args.rflysim is not None
        if by_name:  # requested explicitly: must work before the proxy is ready
            try:
                server.join(open_live(args, engine, server))
            except OSError as error:
                raise ConfigError(
                    f"live control cannot start: {error}; "
                    "raise the limits (ulimit -n, -v), or give --zenoh off"
                ) from None
        gc.enable()
        with stop_on_signals(server) as wake:
            others = ", ".join(link.name for link in links[1:])
            with contextlib.suppress(OSError):  # a full disk must not stop the proxy
                where = sys.stderr if args.json else sys.stdout
                print(f"ready: {links[0].name} <-> {others}", file=where, flush=True)
            if not by_name:
                start_live(args, engine, server)
            server.run(wake)
        # Before closing, which loses the kernel's drop count.
        statistics = server.stats()
    finally:
        # Also after an error, to free the ports.
        for link in links:
            link.close()
    print_result(args, statistics, format_endpoints(statistics))
    return 0

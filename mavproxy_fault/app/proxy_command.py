"""The `proxy` command: links, core, files and live control put together, and run."""

import argparse
import contextlib
import gc
import logging
import signal
import socket
from collections.abc import Iterator, Sequence
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Any

from mavproxy_fault.app.recorder import Recorder
from mavproxy_fault.app.resource_check import check_resources
from mavproxy_fault.app.server import Server
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.links.bus import check_run_name
from mavproxy_fault.links.link import Link
from mavproxy_fault.links.peers import Admission, parse_networks
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
    """The vehicle's link and the others'; all closed again if one cannot be opened."""
    links: list[Link] = []
    try:
        links.append(open_link(master, bare_udp="udpin"))
        links += [open_link(out, bare_udp="udpout") for out in outs]
    # Every error of a wrong link is a ValueError, `ConfigError` among them.
    except ValueError:
        for link in links:
            link.close()
        raise
    return links


def set_admission(links: Sequence[Link], allowed: Sequence[str], *, lock: bool) -> None:
    """Let listening UDP links answer only whom the command line lets in.

    Raises
    ------
    ConfigError
        If one of `allowed` is no network.
    """
    try:
        admission = Admission(parse_networks(allowed), lock, begins_with_frame)
    except ValueError as error:
        raise ConfigError(
            f"--allow-peer: {error}; give an address or network such as 192.168.1.0/24"
        ) from None
    for link in links:
        if isinstance(link, UdpServer):
            link.peers.admission = admission


def link_roles(links: Sequence[Link]) -> list[LinkRole]:
    """The first link is the vehicle's."""
    return [
        LinkRole(link.name, "to-vehicle" if number else "from-vehicle", link.datagrams)
        for number, link in enumerate(links)
    ]


@contextlib.contextmanager
def stop_on_signals(server: Server) -> Iterator[socket.socket]:
    """Let SIGINT and SIGTERM stop the server; gives the socket that wakes it."""
    wake, woken = socket.socketpair()
    woken.setblocking(False)
    names = (signal.SIGINT, signal.SIGTERM)
    # The handler only sets a flag; the wake-up descriptor ends the wait.
    before = [signal.signal(name, lambda *_: server.stop()) for name in names]
    # Full is harmless: one byte wakes as well as many.
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
    """What the options say about signed frames.

    Raises
    ------
    ConfigError
        If the key's file cannot be read.
    """
    if args.signing_key is None:
        return Signing(strip=True) if args.strip_signatures else None
    try:
        with open(args.signing_key) as file:
            phrase = file.read(MOST_KEY_CHARACTERS).strip()  # a device may never end
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(
            f"{args.signing_key}: cannot be read ({error}); give a file with the passphrase"
        ) from None
    return Signing(derive_key(phrase), strip=args.strip_signatures)


def open_live(args: argparse.Namespace, engine: "Engine | None", server: Server) -> "LiveSession":
    """Live control over the bus and RflySim's port; loads all that faults need, numpy too."""
    check_resources()
    # Loaded in the background thread, which may take its time.
    import mavproxy_fault.compiled.plans  # noqa: F401  so that no frame waits for it later
    from mavproxy_fault.live.control import LiveControl
    from mavproxy_fault.live.edit_log import EditLog
    from mavproxy_fault.live.rflysim import DEFAULT_MAP, read_map
    from mavproxy_fault.live.session import LiveSession
    from mavproxy_fault.proxy.engine import Engine
    from mavproxy_fault.schedule.entries import Schedule

    rflysim = read_map(args.rflysim_map or DEFAULT_MAP) if args.rflysim is not None else None
    control = LiveControl(
        engine or Engine(Schedule(0, ()), commands=args.allow_commands),
        allowed=args.inject,
        rflysim=rflysim,
        # Tables are opened only below folders that the command line names.
        folders=[Path(one) for one in args.files],
    )
    live = LiveSession(control, server.edit_time, EditLog(server.core, server.tape))
    if args.rflysim is not None:
        live.open_rflysim(args.rflysim)
    live.open_bus(args.zenoh, args.run, args.zenoh_config)
    return live


def start_live(args: argparse.Namespace, engine: "Engine | None", server: Server) -> None:
    """Open live control in the background."""
    try:
        from concurrent.futures import Future

        from mavproxy_fault.live.session import short_thread_turns
    except OSError as error:  # no descriptor is left to read a module by
        LOG.error("no live control, forwarding goes on: %s", error)
        return
    coming: Future[LiveSession] = Future()

    def work() -> None:
        try:
            with short_thread_turns():
                coming.set_result(open_live(args, engine, server))
        # Into the future, so that the loop sees it: a thread's own traceback would be lost, and
        # the loop would wait for ever for a panic of Zenoh's, which is no Exception.
        except BaseException as error:
            coming.set_exception(error)

    server.opening_live = coming
    try:
        Thread(target=work).start()  # no daemon: what outlives the interpreter aborts the process
    except RuntimeError as error:  # the system allows no further thread
        coming.set_exception(error)


def main(args: argparse.Namespace) -> int:
    """`mavproxy-fault proxy`."""
    # Before any socket is opened: a wrong name costs nothing then.
    if args.run is not None:
        check_run_name(args.run)
    for folder in args.files:
        if not Path(folder).is_dir():
            raise ConfigError(f"--files {folder}: is no folder; give one that tables lie in")
    engine = None
    # `session.json` holds all that a replay needs, so it is gathered along the way.
    session: dict[str, Any] = {"seed": None, "schedule": None, "inject": args.inject}
    if args.schedule:
        from mavproxy_fault.proxy.engine import Engine
        from mavproxy_fault.schedule.entries import read_schedule

        engine = Engine(read_schedule(args.schedule), commands=args.allow_commands)
        if engine.draws:  # or the first frame that a fault draws for would wait for it
            import numpy.random  # noqa: F401
        session |= {"seed": engine.seed, "schedule": Path(args.schedule).read_text()}
    if args.rflysim_map and args.rflysim is None:
        raise ConfigError("--rflysim-map: is for the faults of RflySim; give --rflysim PORT too")
    signed = read_signing(args)
    # Links first: a port that is taken ends the command before anything is written.
    links = open_links(args.master, args.to)
    try:
        set_admission(links, args.allow_peer, lock=args.lock_peer)
        tape = CaptureBuffer() if args.logdir else None
        core = Core(link_roles(links), engine, signing=signed, tape=tape)
        if args.rflysim is not None and args.rflysim_map:
            session["rflysim_map"] = str(Path(args.rflysim_map).resolve())
        session["links"] = [{"name": role.name, "direction": role.direction} for role in core.links]
        recorder = Recorder(Path(args.logdir), session) if args.logdir else None
        server = Server(links, core, tape=tape, recorder=recorder, busy_poll=args.busy_poll)
        server.prepare()
        message_names()  # reads their table: there may be no descriptor for it at the first frame
        by_name = args.zenoh not in ("auto", "off") or args.rflysim is not None
        if by_name:  # what was asked for by name is there when the proxy is ready
            try:
                server.join(open_live(args, engine, server))
            except OSError as error:
                raise ConfigError(
                    f"live control cannot be had: {error}; "
                    "allow more descriptors or memory (ulimit -n, -v), or give --zenoh off"
                ) from None
        gc.enable()
        with stop_on_signals(server) as wake:
            others = ", ".join(link.name for link in links[1:])
            with contextlib.suppress(OSError):  # a full disk behind it stops nothing
                print(f"ready: {links[0].name} <-> {others}", flush=True)
            if not by_name:
                start_live(args, engine, server)
            server.run(wake)
        figures = format_endpoints(
            server.stats()
        )  # a closed socket no longer says what the kernel dropped
    finally:
        # Also after an error: ports must be free for the next start.
        for link in links:
            link.close()
    print(figures, flush=True)
    return 0

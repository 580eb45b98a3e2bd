"""Few descriptors, little memory, nothing that can be written: it says so and forwards."""

import contextlib
import fcntl
import itertools
import json
import os
import resource
import socket
import time
from pathlib import Path

import pytest

from mavproxy_fault.app.playback import split_records
from mavproxy_fault.links.link import enlarge_buffers
from tests.hardening.proxy_process import driven, numbered


@pytest.mark.parametrize(
    ("limits", "reason"),
    [
        ("ulimit -n 16", "Too many open files"),
        ("ulimit -v 300000", "Cannot allocate memory"),
        ("ulimit -v 120000", "Cannot allocate memory"),
    ],
)
def test_a_limited_proxy_goes_without_live_control_and_forwards(limits: str, reason: str) -> None:
    with driven(limits=limits) as proxy:
        assert proxy.process.stderr is not None
        told = ""
        while "no live control" not in told:
            proxy.pass_frame()
            told = proxy.process.stderr.readline()
        assert told.startswith("no live control, forwarding continues: ")
        assert reason in told
        for _ in range(100):
            proxy.pass_frame()
        printed, told = proxy.end()
    assert told == ""
    assert printed.split("\n")[1].split()[2] == str(proxy.sent)


def _told_with_descriptors(limit: int) -> str:
    """What a proxy with so few tells: why it does not start, or what it passes frames without."""
    try:
        with driven("--zenoh", "off", limits=f"ulimit -n {limit}") as proxy:
            for _ in range(20):
                proxy.pass_frame()
            return proxy.end()[1]
    except AssertionError as refusal:
        return str(refusal)


def test_at_every_number_of_descriptors_it_forwards_or_says_why_not() -> None:
    told = [_told_with_descriptors(limit) for limit in range(5, 10)]
    assert not [one for one in told if "Traceback" in one]
    assert "Too many open files" in told[0]
    assert "no live control, forwarding continues" in told[-1]


def test_who_makes_it_write_does_not_stop_a_proxy_that_nobody_reads() -> None:
    with socket.create_server(("127.0.0.1", 0)) as place:
        port = place.getsockname()[1]
    with driven("--zenoh", "off", "--to", f"tcpin:127.0.0.1:{port}") as proxy:
        assert proxy.process.stderr is not None
        fcntl.fcntl(proxy.process.stderr, fcntl.F_SETPIPE_SZ, 4096)
        for _ in range(100):
            with socket.create_connection(("127.0.0.1", port), timeout=20) as stranger:
                stranger.sendall(b"x")
                stranger.shutdown(socket.SHUT_WR)
                while stranger.recv(99):
                    pass
            proxy.pass_frame()
        _, told = proxy.end()
    assert 0 < told.count("nobody is left") < 100


def test_live_control_asked_for_by_name_is_refused_with_the_limit() -> None:
    with (
        pytest.raises(AssertionError, match=r"live control cannot start: .*ulimit -n"),
        driven("--zenoh", "tcp/127.0.0.1:0", limits="ulimit -n 16"),
    ):
        pass


def test_peers_beyond_the_descriptors_are_turned_away_and_the_others_served() -> None:
    with socket.create_server(("127.0.0.1", 0)) as place:
        port = place.getsockname()[1]
    options = ("--zenoh", "off", "--to", f"tcpin:127.0.0.1:{port}")
    with contextlib.ExitStack() as opened, driven(*options, limits="ulimit -n 32") as proxy:
        unknown = []
        for _ in range(40):
            unknown.append(opened.enter_context(socket.create_connection(("127.0.0.1", port))))
            unknown[-1].setblocking(False)
        turned_away = 0
        while unknown:
            proxy.pass_frame()
            for peer in unknown[:]:
                with contextlib.suppress(BlockingIOError):
                    # A frame goes to those who were let in, the others hear the end.
                    turned_away += not peer.recv(1)
                    unknown.remove(peer)
        printed, told = proxy.end()
    assert 8 < turned_away < 40
    assert told.count("no descriptor for a further peer; allow more (ulimit -n)") == 1
    row = next(line for line in printed.splitlines() if line.startswith("tcpin"))
    # One error for each that was turned away: the loop did not go round in vain.
    assert int(row.split()[12]) == turned_away


def test_without_a_home_or_a_folder_to_write_to_it_is_controlled_all_the_same(
    tmp_path: Path,
) -> None:
    nowhere = {"HOME": "/proc/none", "XDG_STATE_HOME": "", "TMPDIR": str(tmp_path)}
    with driven("--zenoh", "tcp/127.0.0.1:0", folder=Path("/proc"), **nowhere) as proxy:
        for _ in range(100):
            proxy.pass_frame()
        _, told = proxy.end()
    assert told == ""


def _memory_of(process: int) -> int:
    """Bytes of address space that a process has."""
    return _told_of(process, "VmSize") * 1024


def _told_of(process: int, name: str) -> int:
    """A number of a process by Linux' name of it."""
    status = Path(f"/proc/{process}/status").read_text()
    return int(status.split(f"{name}:")[1].split()[0])


def test_memory_that_runs_out_meanwhile_costs_the_recording_and_no_frame(tmp_path: Path) -> None:
    with driven("--zenoh", "off", "--logdir", str(tmp_path)) as proxy:
        assert proxy.process.stderr is not None
        enlarge_buffers(proxy.station)
        number = proxy.process.pid
        # Live control joins within a second, and the machine code takes its memory anew for it.
        until_s = time.monotonic() + 3.0
        while time.monotonic() < until_s or _told_of(number, "Threads") > 1:
            proxy.pass_frame()
        _, highest = resource.prlimit(number, resource.RLIMIT_AS)
        resource.prlimit(number, resource.RLIMIT_AS, (_memory_of(number), highest))
        many, told = numbered(0) * 256, ""
        while "recording stopped" not in told:
            for _ in range(10):
                proxy.vehicle.send(many)
            proxy.pass_frame()
            told += _read(proxy.process.stderr.fileno())
            if "forwarding is slower" in told:
                pytest.skip("live control came too late: the memory ran out for something else")
        resource.prlimit(number, resource.RLIMIT_AS, (highest, highest))
        while "recording resumed" not in told:
            proxy.pass_frame()
            told += _read(proxy.process.stderr.fileno())
        came = proxy.end()[0].split("\n")[1].split()[2]
    lost = json.loads((tmp_path / "session.json").read_text())["lost_records"]
    recorded = len(list(split_records((tmp_path / "received.tlog").read_bytes())))
    assert lost > 0
    assert recorded + lost == int(came)


def _read(descriptor: int) -> str:
    """What a process has told by now, without waiting for it."""
    os.set_blocking(descriptor, False)
    with contextlib.suppress(BlockingIOError):
        return os.read(descriptor, 65_536).decode()
    return ""


def _next_descriptor(process: int) -> int:
    """The number that the next descriptor of a process gets."""
    held = {int(name) for name in os.listdir(f"/proc/{process}/fd")}
    return next(number for number in itertools.count() if number not in held)


def test_descriptors_that_run_out_meanwhile_turn_new_peers_away_and_stop_no_frame(
    tmp_path: Path,
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as place:
        port = place.getsockname()[1]
    options = ("--zenoh", "off", "--to", f"tcpin:127.0.0.1:{port}", "--logdir", str(tmp_path))
    with contextlib.ExitStack() as opened, driven(*options) as proxy:

        def first_byte(peer: socket.socket) -> bytes:
            """What a peer hears of frames that pass, nothing if it is turned away."""
            peer.setblocking(False)
            while True:
                proxy.pass_frame()
                with contextlib.suppress(BlockingIOError):
                    return peer.recv(1)

        assert first_byte(opened.enter_context(socket.create_connection(("127.0.0.1", port))))
        number = proxy.process.pid
        _, highest = resource.prlimit(number, resource.RLIMIT_NOFILE)
        resource.prlimit(number, resource.RLIMIT_NOFILE, (_next_descriptor(number), highest))
        # What the proxy had open for a moment only is free below the limit: some are let in yet.
        while first_byte(opened.enter_context(socket.create_connection(("127.0.0.1", port)))):
            pass
        for _ in range(100):
            proxy.pass_frame()
        printed, told = proxy.end()
    assert "no descriptor for a further peer; allow more (ulimit -n)" in told
    assert printed.split("\n")[1].split()[2] == str(proxy.sent)
    recorded = list(split_records((tmp_path / "received.tlog").read_bytes()))
    assert len(recorded) == proxy.sent

"""With few descriptors, little memory or no writable folder the proxy reports it and forwards."""

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

from mavproxy_fault.app.replaying.playback import split_records
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
def test_a_limited_proxy_forwards_without_live_control(limits: str, reason: str) -> None:
    with driven(limits=limits) as proxy:
        assert proxy.process.stderr is not None
        errors = ""
        while "no live control" not in errors:
            proxy.pass_frame()
            errors = proxy.process.stderr.readline()
        assert errors.startswith("no live control, forwarding continues: ")
        assert reason in errors
        for _ in range(100):
            proxy.pass_frame()
        printed, errors = proxy.end()
    assert errors == ""
    assert printed.split("\n")[1].split()[2] == str(proxy.sent)


def _errors_with_descriptors(limit: int) -> str:
    """Errors of a proxy with few descriptors: why it does not start, or what it goes without."""
    try:
        with driven("--zenoh", "off", limits=f"ulimit -n {limit}") as proxy:
            for _ in range(20):
                proxy.pass_frame()
            return proxy.end()[1]
    except AssertionError as refusal:
        return str(refusal)


def test_at_every_number_of_descriptors_it_forwards_or_says_why_not() -> None:
    reports = [_errors_with_descriptors(limit) for limit in range(5, 10)]
    assert not [one for one in reports if "Traceback" in one]
    assert "Too many open files" in reports[0]
    assert "no live control, forwarding continues" in reports[-1]


def test_strangers_cannot_stop_a_proxy_whose_standard_error_is_not_read() -> None:
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
        _, errors = proxy.end()
    assert 0 < errors.count("no peer is left") < 100  # of a hundred, what the pipe had room for


def test_explicitly_requested_live_control_is_refused_with_the_limit() -> None:
    with (
        pytest.raises(AssertionError, match=r"live control cannot start: .*ulimit -n"),
        driven("--zenoh", "tcp/127.0.0.1:0", limits="ulimit -n 16"),
    ):
        pass


def test_peers_beyond_the_descriptors_are_rejected_and_the_others_served() -> None:
    with socket.create_server(("127.0.0.1", 0)) as place:
        port = place.getsockname()[1]
    options = ("--zenoh", "off", "--to", f"tcpin:127.0.0.1:{port}")
    with contextlib.ExitStack() as opened, driven(*options, limits="ulimit -n 32") as proxy:
        unknown = []
        for _ in range(40):
            unknown.append(opened.enter_context(socket.create_connection(("127.0.0.1", port))))
            unknown[-1].setblocking(False)
        rejected = 0
        while unknown:
            proxy.pass_frame()
            for peer in unknown[:]:
                with contextlib.suppress(BlockingIOError):
                    # Accepted peers receive a frame, the others the end of the connection.
                    rejected += not peer.recv(1)
                    unknown.remove(peer)
        printed, errors = proxy.end()
    assert 8 < rejected < 40
    assert errors.count("no descriptor for another peer; raise the limit (ulimit -n)") == 1
    row = next(line for line in printed.splitlines() if line.startswith("tcpin"))
    # One error for each rejected peer: the loop did not spin.
    assert int(row.split()[12]) == rejected


def test_live_control_works_without_a_home_or_a_writable_folder(
    tmp_path: Path,
) -> None:
    nowhere = {"HOME": "/proc/none", "XDG_STATE_HOME": "", "TMPDIR": str(tmp_path)}
    with driven("--zenoh", "tcp/127.0.0.1:0", folder=Path("/proc"), **nowhere) as proxy:
        for _ in range(100):
            proxy.pass_frame()
        _, errors = proxy.end()
    # Kernels cannot be cached there, so they may be compiled meanwhile.
    compiling = "compiling kernels (first use only); forwarding is slower until then\n"
    assert errors in ("", compiling)


def _memory_of(process: int) -> int:
    """Bytes of address space of a process."""
    return _status_of(process, "VmSize") * 1024


def _status_of(process: int, name: str) -> int:
    """A number in a process's status, by its Linux name."""
    status = Path(f"/proc/{process}/status").read_text()
    return int(status.split(f"{name}:")[1].split()[0])


def test_running_out_of_memory_stops_the_recording_but_loses_no_frame(tmp_path: Path) -> None:
    with driven("--zenoh", "off", "--logdir", str(tmp_path)) as proxy:
        assert proxy.process.stderr is not None
        enlarge_buffers(proxy.station)
        number = proxy.process.pid
        # Live control joins within a second, and the compiled path reallocates its memory for it.
        until_s = time.monotonic() + 3.0
        while time.monotonic() < until_s or _status_of(number, "Threads") > 1:
            proxy.pass_frame()
        _, highest = resource.prlimit(number, resource.RLIMIT_AS)
        resource.prlimit(number, resource.RLIMIT_AS, (_memory_of(number), highest))
        many, errors = numbered(0) * 256, ""
        while "recording stopped" not in errors:
            for _ in range(10):
                proxy.vehicle.send(many)
            proxy.pass_frame()
            errors += _read(proxy.process.stderr.fileno())
            if "forwarding is slower" in errors:
                pytest.skip("live control came too late: the memory ran out for something else")
        resource.prlimit(number, resource.RLIMIT_AS, (highest, highest))
        while "recording resumed" not in errors:
            proxy.pass_frame()
            errors += _read(proxy.process.stderr.fileno())
        received = proxy.end()[0].split("\n")[1].split()[2]
    lost = json.loads((tmp_path / "session.json").read_text())["lost_records"]
    recorded = len(list(split_records((tmp_path / "received.tlog").read_bytes())))
    assert lost > 0
    assert recorded + lost == int(received)


def _read(descriptor: int) -> str:
    """Read the output of a process without waiting."""
    os.set_blocking(descriptor, False)
    with contextlib.suppress(BlockingIOError):
        return os.read(descriptor, 65_536).decode()
    return ""


def _next_descriptor(process: int) -> int:
    """The number of a process's next descriptor."""
    held = {int(name) for name in os.listdir(f"/proc/{process}/fd")}
    return next(number for number in itertools.count() if number not in held)


def test_running_out_of_descriptors_rejects_new_peers_but_loses_no_frame(
    tmp_path: Path,
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as place:
        port = place.getsockname()[1]
    options = ("--zenoh", "off", "--to", f"tcpin:127.0.0.1:{port}", "--logdir", str(tmp_path))
    with contextlib.ExitStack() as opened, driven(*options) as proxy:

        def first_byte(peer: socket.socket) -> bytes:
            """The first byte that a peer receives, empty if it is rejected."""
            peer.setblocking(False)
            while True:
                proxy.pass_frame()
                with contextlib.suppress(BlockingIOError):
                    return peer.recv(1)

        assert first_byte(opened.enter_context(socket.create_connection(("127.0.0.1", port))))
        number = proxy.process.pid
        _, highest = resource.prlimit(number, resource.RLIMIT_NOFILE)
        resource.prlimit(number, resource.RLIMIT_NOFILE, (_next_descriptor(number), highest))
        # Briefly used descriptors are free below the limit: a few more peers are accepted.
        while first_byte(opened.enter_context(socket.create_connection(("127.0.0.1", port)))):
            pass
        for _ in range(100):
            proxy.pass_frame()
        printed, errors = proxy.end()
    assert "no descriptor for another peer; raise the limit (ulimit -n)" in errors
    assert printed.split("\n")[1].split()[2] == str(proxy.sent)
    recorded = list(split_records((tmp_path / "received.tlog").read_bytes()))
    assert len(recorded) == proxy.sent

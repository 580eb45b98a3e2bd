import contextlib
import os
import signal
import socket
import subprocess
import sys
import urllib.error
import urllib.request
from pathlib import Path


def test_a_second_signal_ends_the_page_in_order_too(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "mavproxy_fault.cli", "ui", "--port", "0"]
    no_router = ["--zenoh", "tcp/127.0.0.1:9"]
    environment = {**os.environ, "XDG_STATE_HOME": str(tmp_path)}
    with subprocess.Popen(
        [*command, *no_router],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment,
    ) as page:  # fmt: skip
        assert page.stdout is not None
        address = page.stdout.readline().partition(" ")[2].partition("#")[0]
        try:  # an answer of any kind: it is up, and hears signals
            urllib.request.urlopen(address, timeout=60).close()
        except urllib.error.HTTPError as refused:
            refused.close()
        page.send_signal(signal.SIGTERM)
        with contextlib.suppress(ConnectionRefusedError, ConnectionResetError):
            while True:  # until it has begun to end
                socket.create_connection(("127.0.0.1", int(address.split(":")[2][:-1])), 60).close()
        page.send_signal(signal.SIGINT)
        summary, errors = page.communicate(timeout=60)
    # uvicorn logged cancelled tasks, and the source's thread could abort the process.
    assert (page.returncode, errors) == (0, "")
    assert summary.startswith("stopped after ")


def test_a_signal_that_comes_when_all_is_done_changes_nothing(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "mavproxy_fault.cli", "ui", "--port", "0"]
    environment = {**os.environ, "XDG_STATE_HOME": str(tmp_path)}
    with subprocess.Popen(
        [*command, "--zenoh", "tcp/127.0.0.1:9"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment,
    ) as page:  # fmt: skip
        assert page.stdout is not None
        page.stdout.readline()
        page.send_signal(signal.SIGTERM)
        assert page.stdout.readline().startswith("stopped after ")
        while page.poll() is None:  # from here to the last of the interpreter
            page.send_signal(signal.SIGINT)
            page.send_signal(signal.SIGTERM)
        _, errors = page.communicate()
    assert (page.returncode, errors) == (0, "")

"""What Linux alone has is missing elsewhere: modules can be imported, links and a run work."""

import subprocess
import sys
from pathlib import Path

import pytest

TESTS = Path(__file__).parent

# In a process of its own, since modules are imported once. What is hidden is hidden from our
# modules only, or gone for all: libraries look for themselves what there is.
MASK = """
import builtins, ctypes, importlib, os, pkgutil, select, signal, socket, sys

ours = ("mavproxy_fault", "simvehicle", "analysis")
hidden = {"fcntl", "resource", "grp", "pwd", "pty", "tty", "posix", "termios"}
gone = {
    select: ["epoll", "EPOLLIN", "EPOLLOUT", "poll"],
    socket: ["SO_REUSEPORT", "AF_UNIX", "MSG_DONTWAIT"],
    signal: ["pthread_sigmask"],
}
original = builtins.__import__

def masked(name, globals=None, *rest, **named):
    if name in hidden and globals and globals.get("__name__", "").startswith(ours):
        raise ImportError(name)
    return original(name, globals, *rest, **named)

def no_library(name, *rest, **named):
    if name is None:
        raise TypeError("as on Windows")
    return library(name, *rest, **named)

builtins.__import__ = masked
library, ctypes.CDLL, ctypes.PyDLL = ctypes.CDLL, no_library, no_library
for module, names in gone.items():
    for name in names:
        if hasattr(module, name):
            delattr(module, name)
import selectors
selectors.DefaultSelector = selectors.SelectSelector
"""
# What pytest and subprocess want themselves.
IMPORTS = """
for name in ["SIGKILL", "SIGHUP"]:
    delattr(signal, name)
for name in ["getuid", "geteuid", "fork", "killpg", "setsid", "sched_getaffinity",
             "sched_setscheduler", "sched_getscheduler", "sched_param", "SCHED_RESET_ON_FORK"]:
    delattr(os, name)
count = 0
for name in ours:
    package = importlib.import_module(name)
    for found in pkgutil.walk_packages(package.__path__, name + "."):
        if not found.name.startswith("mavproxy_fault.machine_code"):
            importlib.import_module(found.name)
            count += 1
print(count)
"""
SERIAL = """
sys.modules["termios"] = None
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.links.spec import open_link
try:
    open_link("COM3,57600")
except ConfigError as error:
    print(error)
"""
PYTEST = """
import pytest
code = pytest.main(sys.argv[1:])
from mavproxy_fault.links import udp
assert not udp.IS_LINUX
sys.exit(code)
"""


def run_masked(code: str, *arguments: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, "-c", MASK + code, *arguments], capture_output=True, text=True
    )


def test_every_module_is_imported_without_what_only_linux_has() -> None:
    done = run_masked(IMPORTS)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) > 300


def test_a_serial_device_tells_what_is_missing() -> None:
    assert run_masked(SERIAL).stdout == (
        "COM3,57600: serial devices need termios, which this system lacks; "
        "allowed here: udpin, udpout, tcp, tcpin\n"
    )


@pytest.mark.parametrize("room", ["links", "app/test_server.py"])
def test_links_and_the_proxys_loop_pass_their_tests_the_plain_way(room: str) -> None:
    tests = TESTS / "mavproxy_fault" / room
    done = run_masked(
        PYTEST, "-q", "-p", "no:cacheprovider", "-k", "not compiled_kernels", str(tests)
    )
    assert done.returncode == 0, done.stdout + done.stderr

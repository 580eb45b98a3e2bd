import asyncio
import contextlib
import socket
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

import mavproxy_fault
from mavproxy_fault.links.bus import choose_free_port
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame
from mavproxy_fault.wire.parser import Parser
from mavproxy_fault.wire.tlog import read_columns

ANY = "udpin:127.0.0.1:0"
GPS = message_layout("GPS_RAW_INT")


class Ends:
    """A vehicle that sends GPS_RAW_INT to a proxy, and a station that receives it."""

    def __init__(self, vehicle: socket.socket, station: socket.socket) -> None:
        self.vehicle, self.station = vehicle, station
        self.count = 0

    def fix_type(self, sent: int = 3) -> int:
        """Send one more frame and return the received fix type."""
        self.count += 1
        values = {"time_usec": 1_000_000 + self.count * 20_000, "fix_type": sent}
        self.vehicle.send(build_frame(GPS, values, seq=self.count & 255))
        while True:
            for item in Parser().push(self.station.recv(999), datagram=True):
                if isinstance(item, Frame) and item.id == GPS.id:
                    return int(item.number("fix_type"))

    def while_sending(self, call, *arguments):
        """Return the result of a call while the vehicle keeps sending."""
        with ThreadPoolExecutor(1) as pool:
            outcome = pool.submit(call, *arguments)
            while not outcome.done():
                self.fix_type()
            return outcome.result()


@contextlib.contextmanager
def ends(addresses: list[str]) -> Iterator[Ends]:
    with contextlib.ExitStack() as stack:
        socks = []
        for address in addresses:
            sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            stack.enter_context(contextlib.closing(sock))
            sock.settimeout(10)
            sock.connect(("127.0.0.1", int(address.rsplit(":", 1)[1])))
            socks.append(sock)
        vehicle, station = socks
        heartbeat = build_frame(message_layout("HEARTBEAT"), {"type": 6}, system=255)
        vehicle.send(build_frame(message_layout("HEARTBEAT"), {"type": 2}))
        station.send(heartbeat)
        assert vehicle.recv(999) == heartbeat
        yield Ends(vehicle, station)


def test_a_fault_acts_as_long_as_its_block_and_is_labelled() -> None:
    with mavproxy_fault.Proxy(ANY, ANY) as proxy, ends(proxy.addresses) as both:
        assert both.fix_type() == 3
        with proxy.fault("constant", target="GPS_RAW_INT.fix_type", value=1, id="no-fix") as fault:
            assert fault.id == "no-fix"
            assert both.fix_type() == 1
            fault.update(2)
            assert both.fix_type() == 2
        assert both.fix_type() == 3
        (label,) = proxy.labels
    assert (label.id, label.frames, label.magnitude) == ("no-fix", 2, 2)
    assert label.end_us is not None


def test_clearing_a_fault_twice_is_allowed() -> None:
    with mavproxy_fault.Proxy(ANY, ANY) as proxy, ends(proxy.addresses) as both:
        both.fix_type()
        with proxy.fault("constant", target="GPS_RAW_INT.fix_type", value=1):
            proxy.clear()
            assert both.fix_type() == 3


def test_a_wait_ends_when_a_sent_message_meets_the_condition() -> None:
    with mavproxy_fault.Proxy(ANY, ANY) as proxy, ends(proxy.addresses) as both:
        both.while_sending(proxy.wait_for, "GPS_RAW_INT.fix_type == 3")
        with proxy.fault("constant", target="GPS_RAW_INT.fix_type", value=1):
            both.while_sending(proxy.wait_for, "GPS_RAW_INT.fix_type < 3")
            with pytest.raises(TimeoutError, match="fix_type == 3"):
                both.while_sending(proxy.wait_for, "GPS_RAW_INT.fix_type == 3", 0.2)


def test_errors_have_the_text_of_the_command_line() -> None:
    with mavproxy_fault.Proxy(ANY, ANY) as proxy:
        with pytest.raises(mavproxy_fault.ConfigError, match="nonsense is neither a fault"):
            proxy.fault("nonsense")
        with pytest.raises(mavproxy_fault.ConfigError, match="fix_typ"):
            proxy.wait_for("GPS_RAW_INT.fix_typ < 3")
    with pytest.raises(mavproxy_fault.ConfigError, match="is closed"):
        proxy.fault("drop", target="GPS_RAW_INT")
    with pytest.raises(mavproxy_fault.ConfigError, match="connection string"):
        mavproxy_fault.Proxy("nowhere", ANY)


def test_a_schedule_can_be_a_dictionary_and_the_recording_is_complete(tmp_path: Path) -> None:
    bias = {"fault": "bias", "target": "GPS_RAW_INT.fix_type", "value": 2, "at_s": 0.05}
    schedule = {"seed": 1, "faults": [bias]}
    with (
        mavproxy_fault.Proxy(ANY, ANY, schedule=schedule, logdir=tmp_path) as proxy,
        ends(proxy.addresses) as both,
    ):
        seen = [both.fix_type() for _ in range(6)]
    assert seen == [3, 3, 3, 5, 5, 5]
    assert read_columns(tmp_path / "sent.tlog")["GPS_RAW_INT"]["fix_type"].tolist() == seen


def test_the_proxy_works_with_asyncio() -> None:
    async def script() -> list[object]:
        async with mavproxy_fault.AsyncProxy(ANY, ANY) as proxy:
            with ends(proxy.addresses) as both:
                both.fix_type()
                fault = await proxy.fault("constant", target="GPS_RAW_INT.fix_type", value=1)
                async with fault:
                    waiting = asyncio.create_task(proxy.wait_for("GPS_RAW_INT.fix_type < 3"))
                    while not waiting.done():
                        await asyncio.to_thread(both.fix_type)
                    await waiting
                return [both.fix_type(), len(await proxy.labels())]

    with ThreadPoolExecutor(1) as pool:  # the browser tests may have left a loop in this one
        assert pool.submit(asyncio.run, script()).result() == [3, 1]


def test_a_proxy_of_another_process_can_be_joined() -> None:
    url = choose_free_port("tcp/127.0.0.1:0")
    with (
        mavproxy_fault.Proxy(ANY, ANY, zenoh=url) as owner,
        ends(owner.addresses) as both,
        mavproxy_fault.Proxy.attach(url) as guest,
    ):
        both.fix_type()
        with guest.fault("constant", target="GPS_RAW_INT.fix_type", value=1):
            assert both.fix_type() == 1
            both.while_sending(guest.wait_for, "GPS_RAW_INT.fix_type == 1")
        assert both.fix_type() == 3
        assert owner.labels[0].frames >= 2


def test_joining_a_missing_proxy_fails() -> None:
    with pytest.raises(mavproxy_fault.ConfigError, match="no proxy or run"):
        mavproxy_fault.Proxy.attach(choose_free_port("tcp/127.0.0.1:0"))


def test_importing_the_package_loads_nothing_heavy() -> None:
    code = "import mavproxy_fault, sys; print('numpy' in sys.modules, 'msgspec' in sys.modules)"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.split() == ["False", "False"]
    with pytest.raises(AttributeError, match="nothing"):
        _ = mavproxy_fault.nothing  # type: ignore[attr-defined]

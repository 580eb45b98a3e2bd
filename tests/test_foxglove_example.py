"""The bridge to Foxglove between a real proxy and a client of Foxglove's protocol."""

import json
import socket
import struct
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

import mavproxy_fault
from mavproxy_fault.links.bus import choose_free_port
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import build_frame

pytest.importorskip("foxglove", reason="foxglove-sdk is not installed")
websockets = pytest.importorskip("websockets.sync.client", reason="websockets is not installed")

BRIDGE = Path(__file__).parents[1] / "examples" / "views" / "foxglove_live.py"
# The latitude in degrees, without and with the fault.
TOPICS = {"/position/received/HIL_GPS": 47.4, "/position/sent/HIL_GPS": 47.5}


@pytest.fixture
def proxy() -> Iterator[tuple[mavproxy_fault.Proxy, str]]:
    url = choose_free_port("tcp/127.0.0.1:0")
    jump = {"fault": "bias", "target": "HIL_GPS.lat", "value": 1e6}  # 0.1 degrees
    with mavproxy_fault.Proxy(
        "udpin:127.0.0.1:0", "udpin:127.0.0.1:0", schedule={"faults": [jump]}, zenoh=url
    ) as owner:
        yield owner, url


def latitude_of(message: bytes) -> float:
    """The latitude of a LocationFix in protobuf: field 1, a double."""
    return float(struct.unpack_from("<d", message, message.index(b"\x09") + 1)[0])


def test_positions_before_and_after_a_fault_reach_foxglove(
    proxy: tuple[mavproxy_fault.Proxy, str],
) -> None:
    owner, url = proxy
    command = [sys.executable, str(BRIDGE), "--zenoh", url, "--port", "0"]
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle,
        subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as bridge,
    ):
        assert bridge.stdout is not None
        address = bridge.stdout.readline().strip()
        with websockets.connect(address, subprotocols=["foxglove.sdk.v1"]) as viewer:
            topics: dict[int, str] = {}
            found: dict[str, float] = {}
            for number in range(1000):  # the bridge's subscription reaches the proxy by and by
                values = {"time_usec": number * 200_000, "lat": 474_000_000}
                frame = build_frame(message_layout("HIL_GPS"), values, seq=number & 255)
                vehicle.sendto(frame, ("127.0.0.1", int(owner.addresses[0].rpartition(":")[2])))
                with suppress(TimeoutError):
                    while found.keys() != TOPICS.keys():
                        said = viewer.recv(timeout=0.05)
                        if isinstance(said, str):
                            for one in json.loads(said).get("channels", ()):
                                topics[one["id"]] = one["topic"]
                                wanted = {"id": one["id"], "channelId": one["id"]}
                                subscribe = {"op": "subscribe", "subscriptions": [wanted]}
                                viewer.send(json.dumps(subscribe))
                                if one["topic"] in TOPICS:
                                    assert one["schemaName"] == "foxglove.LocationFix"
                        elif topics.get(int.from_bytes(said[1:5], "little")) in TOPICS:
                            topic = topics[int.from_bytes(said[1:5], "little")]
                            found[topic] = latitude_of(said[13:])
                if found.keys() == TOPICS.keys():
                    break
            assert found == pytest.approx(TOPICS)
        bridge.terminate()

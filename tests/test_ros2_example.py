"""The ROS 2 bridge between a real proxy and a router in ROS 2's place."""

import json
import signal
import struct
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from queue import Queue

import pytest
import zenoh

import mavproxy_fault
from mavproxy_fault.links.bus import choose_free_port, open_bus

BRIDGE = Path(__file__).parents[1] / "examples" / "ros2" / "ros2_bridge.py"
STRING = (
    "std_msgs::msg::dds_::String_/"
    "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
)
ARM = f"0/mavproxy_fault/arm/{STRING}"
ANY = "udpin:127.0.0.1:0"
PATIENCE_S = 60.0  # only ever waited for in full when something is broken


def message(text: str) -> bytes:
    """A std_msgs/msg/String in little-endian CDR."""
    return b"\x00\x01\x00\x00" + struct.pack("<I", len(text) + 1) + text.encode() + b"\x00"


@pytest.fixture
def ros() -> Iterator[tuple[zenoh.Session, str]]:
    """A router where rmw_zenohd would be, and its address."""
    url = choose_free_port("tcp/127.0.0.1:0")
    config = zenoh.Config()
    config.insert_json5("mode", '"router"')
    config.insert_json5("listen/endpoints", json.dumps([url]))
    config.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(config) as session:
        yield session, url


@pytest.fixture
def proxy() -> Iterator[tuple[mavproxy_fault.Proxy, str]]:
    url = choose_free_port("tcp/127.0.0.1:0")
    with mavproxy_fault.Proxy(ANY, ANY, zenoh=url) as owner:
        yield owner, url


@pytest.fixture
def bridge(
    ros: tuple[zenoh.Session, str], proxy: tuple[mavproxy_fault.Proxy, str]
) -> Iterator[None]:
    """The bridge as a user starts it, once it is there."""
    words = [sys.executable, str(BRIDGE), "--proxy", proxy[1], "--ros", ros[1]]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert "/mavproxy_fault/events" in process.stdout.readline()
        yield
        process.send_signal(signal.SIGTERM)
    assert process.returncode == 0


@pytest.mark.usefixtures("bridge")
def test_a_topic_arms_a_fault_and_another_has_the_answer(
    ros: tuple[zenoh.Session, str],
) -> None:
    session, _ = ros
    answers: Queue[zenoh.Sample] = Queue()
    session.declare_subscriber(f"0/mavproxy_fault/answers/{STRING}", answers.put)
    entry = {"id": "gyro", "fault": "bias", "target": "HIL_SENSOR.xgyro", "value": 0.1}
    session.put(ARM, message(json.dumps(entry)))
    answer = answers.get(timeout=PATIENCE_S)
    assert b"armed" in answer.payload.to_bytes()
    sequence, stamp_ns, length = struct.unpack_from("<qqB", answer.attachment.to_bytes())
    assert (sequence, length) == (1, 16)
    assert stamp_ns > 0
    session.put(ARM, message("nonsense"))
    assert b"no JSON object with an id" in answers.get(timeout=PATIENCE_S).payload.to_bytes()


@pytest.mark.usefixtures("bridge")
def test_a_verdict_becomes_a_message(
    ros: tuple[zenoh.Session, str], proxy: tuple[mavproxy_fault.Proxy, str]
) -> None:
    session, _ = ros
    events: Queue[zenoh.Sample] = Queue()
    session.declare_subscriber(f"0/mavproxy_fault/events/{STRING}", events.put)
    with open_bus(proxy[1]) as bus:
        bus.put("fdi/events", b'{"alarm":true}')
        assert events.get(timeout=PATIENCE_S).payload.to_bytes() == message('{"alarm":true}')


@pytest.mark.usefixtures("bridge")
def test_ros_sees_a_node_with_its_topics(ros: tuple[zenoh.Session, str]) -> None:
    session, _ = ros
    tokens_seen: Queue[zenoh.Sample] = Queue()
    session.liveliness().declare_subscriber("@ros2_lv/**", tokens_seen.put, history=True)
    tokens = [str(tokens_seen.get(timeout=PATIENCE_S).key_expr) for _ in range(4)]
    kinds = sorted(token.split("/")[5] for token in tokens)
    assert kinds == ["MP", "MP", "MS", "NN"]
    assert any("/%mavproxy_fault%arm/" in token and token.endswith(",") for token in tokens)

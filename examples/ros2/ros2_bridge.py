"""A ROS 2 node that publishes results and accepts faults, by rmw_zenoh's keys.

    /mavproxy_fault/events   std_msgs/msg/String, out: results that changed a verdict, as JSON
    /mavproxy_fault/arm      std_msgs/msg/String, in: an entry of a schedule with its `id`, as JSON
    /mavproxy_fault/answers  std_msgs/msg/String, out: the proxy's reply to it

It needs eclipse-zenoh alone, not ROS 2. Start it beside `ros2 run rmw_zenoh_cpp rmw_zenohd`
(Jazzy or later) and a `mavproxy-fault run` or `proxy` on another address:

    mavproxy-fault run --zenoh tcp/127.0.0.1:7448 --speed 1 --out out
    python ros2_bridge.py --proxy tcp/127.0.0.1:7448 --ros tcp/127.0.0.1:7447
    ros2 topic echo /mavproxy_fault/events
"""

import argparse
import json
import os
import signal
import struct
import time
from pathlib import Path
from threading import Thread

import zenoh

# std_msgs/msg/String: its name in DDS and the hash of its definition (REP 2016).
TYPE = "std_msgs::msg::dds_::String_"
TYPE_HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
QOS = "::,10:,:,:,,"  # rmw_zenoh's short form of ROS 2's default: reliable, volatile, last 10
GID_BYTES = 16
CDR_LITTLE_ENDIAN = b"\x00\x01\x00\x00"
NODE = "mavproxy_fault"
STOP = {signal.SIGINT, signal.SIGTERM}
STATE = Path(os.environ.get("XDG_STATE_HOME", "~/.local/state")).expanduser()
PASSWORD = STATE / "mavproxy-fault" / "zenoh" / "config.json5"


def encode_string(text: str) -> bytes:
    """Encode a std_msgs/msg/String in CDR."""
    data = text.encode() + b"\x00"
    return CDR_LITTLE_ENDIAN + struct.pack("<I", len(data)) + data


def decode_string(message: bytes) -> str:
    """Return the text of a std_msgs/msg/String in CDR."""
    order = "<I" if message[1] else ">I"
    (length,) = struct.unpack_from(order, message, len(CDR_LITTLE_ENDIAN))
    return message[8 : 8 + length - 1].decode()


class RosNode:
    """A node as in rmw_zenoh: a liveliness token for itself and for each of its endpoints."""

    def __init__(self, session: zenoh.Session, domain: int) -> None:
        self._session, self._domain = session, domain
        self._entities = 0
        self._kept: list[object] = [self._announce("NN", "")]  # ends with its last reference

    def publisher(self, topic: str) -> "RosPublisher":
        """Return a publisher of text on a topic such as `/mavproxy_fault/events`."""
        self._kept.append(self._announce("MP", topic))
        return RosPublisher(self._session.declare_publisher(self._key(topic)), self._entities)

    def subscribe(self, topic: str, callback) -> None:
        """Call `callback(text)` for each message of a topic."""
        self._kept.append(self._announce("MS", topic))
        self._kept.append(
            self._session.declare_subscriber(
                self._key(topic), lambda sample: callback(decode_string(sample.payload.to_bytes()))
            )
        )

    def _key(self, topic: str) -> str:
        return f"{self._domain}/{topic.strip('/')}/{TYPE}/{TYPE_HASH}"

    def _announce(self, kind: str, topic: str) -> object:
        number, zid = self._entities, self._session.info.zid()
        self._entities += 1
        key = f"@ros2_lv/{self._domain}/{zid}/0/{number}/{kind}/%/%/{NODE}"
        if topic:
            key += f"/{topic.replace('/', '%')}/{TYPE}/{TYPE_HASH}/{QOS}"
        return self._session.liveliness().declare_token(key)


class RosPublisher:
    """One topic; a message carries its number, time and sender, without which ROS 2 drops it."""

    def __init__(self, publisher: zenoh.Publisher, entity: int) -> None:
        self._publisher = publisher
        self._gid = entity.to_bytes(GID_BYTES, "big")
        self._sequence = 0

    def publish(self, text: str) -> None:
        """Send a text."""
        self._sequence += 1
        stamp = struct.pack("<qqB", self._sequence, time.time_ns(), GID_BYTES) + self._gid
        self._publisher.put(encode_string(text), attachment=stamp)


def bridge(proxy: zenoh.Session, ros: zenoh.Session, run: str, domain: int) -> list[object]:
    """Join the two; lasts as long as what it returns."""
    node = RosNode(ros, domain)
    events = node.publisher("/mavproxy_fault/events")
    answers = node.publisher("/mavproxy_fault/answers")

    def arm(text: str) -> None:
        try:
            entry = json.loads(text)
            key = f"mavfault/v1/{run}/@ctl/fault/{entry.pop('id')}/arm"
        except (ValueError, KeyError, AttributeError):
            answers.publish(json.dumps({"error": f"{text}: no JSON object with an id"}))
            return
        replies = list(proxy.get(key, payload=json.dumps(entry)))
        for reply in replies:
            answer = reply.ok if reply.ok is not None else reply.err
            answers.publish(answer.payload.to_string())
        if not replies:
            answers.publish(json.dumps({"error": f"no proxy replies for the run {run}"}))

    # A query waits for its answer, which Zenoh's own thread must not do.
    node.subscribe("/mavproxy_fault/arm", lambda text: Thread(target=arm, args=[text]).start())
    subscriber = proxy.declare_subscriber(
        f"mavfault/v1/{run}/fdi/events", lambda sample: events.publish(sample.payload.to_string())
    )
    return [node, subscriber]


def client(endpoint: str, config: zenoh.Config) -> zenoh.Session:
    """A session at a router."""
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    return zenoh.open(config)


def main() -> None:
    """Run until Ctrl-C."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--proxy", default="tcp/127.0.0.1:7448", help="where the proxy listens")
    parser.add_argument("--ros", default="tcp/127.0.0.1:7447", help="the router of rmw_zenoh")
    parser.add_argument("--run", default="*", help="the run's name (default: every one)")
    parser.add_argument("--domain", type=int, default=0, help="ROS_DOMAIN_ID")
    args = parser.parse_args()
    signal.pthread_sigmask(signal.SIG_BLOCK, STOP)  # before Zenoh's threads: they inherit it
    ours = zenoh.Config.from_file(str(PASSWORD)) if PASSWORD.exists() else zenoh.Config()
    with client(args.proxy, ours) as proxy, client(args.ros, zenoh.Config()) as ros:
        kept = bridge(proxy, ros, args.run, args.domain)
        for session in (proxy, ros):  # a router answers behind what was declared before
            list(session.liveliness().get("mavproxy_fault/ready"))
        print(
            "/mavproxy_fault/events, /mavproxy_fault/arm, /mavproxy_fault/answers; Ctrl-C ends",
            flush=True,
        )
        signal.sigwait(STOP)
        kept.clear()


if __name__ == "__main__":
    main()

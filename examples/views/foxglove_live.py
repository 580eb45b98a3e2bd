"""Show a flight in Foxglove while it lasts: a bridge from the proxy's Zenoh router.

    mavproxy-fault run --ui                # or any proxy or run on the default bus
    python foxglove_live.py                # then open its ws:// address in Foxglove

It needs eclipse-zenoh and foxglove-sdk (`pip install foxglove-sdk`).
"""

import argparse
import json
import os
import time
from pathlib import Path

import foxglove
import zenoh
from foxglove.messages import (
    FrameTransform,
    LocationFix,
    Log,
    LogLevel,
    Quaternion,
    Timestamp,
    Vector3,
)

MESSAGES = [
    "HIL_SENSOR", "HIL_GPS", "HIL_STATE_QUATERNION", "GPS_RAW_INT", "GLOBAL_POSITION_INT",
    "ATTITUDE_QUATERNION", "SCALED_IMU", "ESTIMATOR_STATUS",
]  # fmt: skip
STATE = Path(os.environ.get("XDG_STATE_HOME", "~/.local/state")).expanduser()
PASSWORD = STATE / "mavproxy-fault" / "zenoh" / "config.json5"
Q = ("q1", "q2", "q3", "q4")
ZERO = Vector3(x=0.0, y=0.0, z=0.0)


def show(sample: zenoh.Sample) -> None:
    """Log a payload of the bus: numbers as JSON, positions and attitudes in Foxglove's types."""
    stream = "/".join(str(sample.key_expr).split("/")[3:])
    payload = json.loads(sample.payload.to_bytes())
    if stream == "proxy/watched":
        for watched in payload:
            for side in ("received", "sent"):
                # Without a fault both sides are equal, and only one is published.
                for row in watched[side] or watched["received"]:
                    show_message(f"/{side}/{watched['message']}", row, watched["fields"])
    elif stream in ("fdi/events", "proxy/labels"):
        t_ns = payload.get("t_us", payload.get("start_us", 0)) * 1000
        text = Log(level=LogLevel.Warning, name=stream, message=json.dumps(payload), **at(t_ns))
        foxglove.log("/log", text, log_time=t_ns)
    elif isinstance(payload, dict) and "t_us" in payload:
        foxglove.log(f"/{stream}", payload, log_time=payload["t_us"] * 1000)


def at(t_ns: int) -> dict[str, Timestamp]:
    """Return the keyword of a message of Foxglove's that has a time of its own."""
    return {"timestamp": Timestamp(*divmod(t_ns, 1_000_000_000))}


def show_message(topic: str, row: list, fields: list[str]) -> None:
    """Log one message; its first number is the vehicle's time."""
    values, t_ns = dict(zip(fields, row[1:], strict=True)), row[0] * 1000
    foxglove.log(topic, values, log_time=t_ns)
    if "lat" in values and "alt" in values:
        place = LocationFix(
            latitude=values["lat"] * 1e-7, longitude=values["lon"] * 1e-7,
            altitude=values["alt"] * 1e-3, frame_id=topic, **at(t_ns),
        )  # fmt: skip
        foxglove.log(f"/position{topic}", place, log_time=t_ns)
    # HIL_STATE_QUATERNION and ATTITUDE_QUATERNION: body (front, right, down) to north, east, down.
    q = [v for name, v in values.items() if name.startswith("attitude_q") or name in Q]
    if len(q) == 4:
        turn = Quaternion(w=q[0], x=q[1], y=q[2], z=q[3])
        frames = {"parent_frame_id": "north east down", "child_frame_id": topic}
        transform = FrameTransform(**frames, translation=ZERO, rotation=turn, **at(t_ns))
        foxglove.log("/transforms", transform, log_time=t_ns)


def main() -> None:
    """Run until Ctrl-C."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--zenoh", default="tcp/127.0.0.1:7447", help="where the proxy listens")
    parser.add_argument("--port", type=int, default=8765, help="of the server for Foxglove")
    args = parser.parse_args()
    config = zenoh.Config.from_file(str(PASSWORD)) if PASSWORD.exists() else zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([args.zenoh]))
    server = foxglove.start_server(name="mavproxy-fault", port=args.port)
    with zenoh.open(config) as session:
        session.declare_subscriber("mavfault/v1/**", show)
        print(f"ws://127.0.0.1:{server.port}", flush=True)
        while True:
            # A subscription to messages ends five seconds after its last renewal.
            list(session.get("mavfault/v1/*/@ctl/watch", payload=json.dumps(MESSAGES)))
            time.sleep(2)


if __name__ == "__main__":
    main()

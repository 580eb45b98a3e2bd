"""Queries with arbitrary content: each is answered soon, without a bug, and the proxy continues.

`QUERIES=10000 pytest -s tests/hardening/test_control_queries.py` is the long form.
"""

import json
import os
import random
import signal
import socket
import subprocess
import sys
from typing import Any

import zenoh

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.faults.registry import known_faults
from mavproxy_fault.links.bus import Bus, open_bus
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import build_frame

QUERIES = int(os.environ.get("QUERIES", "300"))
IDS = ["a", "b", "c", "all", "", "é", "x" * 300, "a b", "..", "-1"]
WILD: list[Any] = [
    0, -1, 1e300, -1e-300, 2**63, 10**30, True, None, "", "x", "010", "1:30", [], {}, [1, 2],
    [[[[]]]], {"uniform": [1, 0]}, {"live": {"timeout_s": 1}}, "PSEUDORANGE.G12", "PLANT.x",
    "HIL_SENSOR.xgyro", ["ATTITUDE.roll", "ATTITUDE.roll"], "/etc/passwd", {"table": "/etc/passwd"},
]  # fmt: skip
KEYS = ["fault", "target", "value", "at_s", "for_s", "repeat", "after", "when", "profile", "id",
        "probability", "axis", "preset", "seed", "sent_us", "nonsense"]  # fmt: skip


def entry(rng: random.Random) -> dict[str, Any]:
    """A fault's own example, or one with a few keys of it made wild."""
    kind = rng.choice(list(known_faults().items()))
    made = {"fault": kind[0], **(getattr(kind[1], "example", None) or {})}
    for _ in range(rng.choice([0, 1, 1, 2])):
        made[rng.choice(KEYS)] = rng.choice(WILD)
    return made


def query(rng: random.Random) -> tuple[str, bytes]:
    """The end of a key, and a payload."""
    kind = rng.randrange(8)
    id = rng.choice(IDS)
    if kind <= 2:
        what, payload = f"fault/{id}/arm", json.dumps(entry(rng)).encode()
    elif kind == 3:
        values = {"value": rng.choice(WILD), "sent_us": rng.choice([*WILD, 0, 10**15])}
        what, payload = f"fault/{id}/value", json.dumps(values).encode()
    elif kind == 4:
        what, payload = f"fault/{id}/{rng.choice(['disarm', 'x', 'arm', 'value'])}", b""
    elif kind == 5:
        faults = [entry(rng) for _ in range(rng.randrange(4))]
        what = rng.choice(["schedule/load", "schedule/begin"])
        payload = json.dumps({"seed": rng.choice([1, *WILD]), "faults": faults}).encode()
    elif kind == 6:
        what = rng.choice(["state", "schedule/save", "schedule/stop", "schedule/x", "x", "watch"])
        payload = b""
    else:
        what, payload = f"fault/{id}/arm", rng.randbytes(rng.randrange(200))
    if payload and rng.random() < 0.2:
        at = rng.randrange(len(payload))
        payload = payload[:at] + rng.randbytes(1) + payload[at + rng.randrange(3) :]
    return what, payload


def answer(bus: Bus, what: str, payload: bytes) -> str:
    """The answer or refusal of one query; empty where the key itself is none."""
    try:
        return bus.query(f"@ctl/{what}", payload, timeout_s=60)[0].decode()
    except ConfigError as refused:
        return str(refused)
    except zenoh.ZError:  # a key that Zenoh itself does not take
        return ""


def test_no_query_stops_the_proxy_or_reveals_a_bug() -> None:
    with (
        socket.socket() as free,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as station,
    ):
        free.bind(("127.0.0.1", 0))
        url = f"tcp/127.0.0.1:{free.getsockname()[1]}"
        free.close()
        station.bind(("127.0.0.1", 0))
        station.settimeout(60)
        command = [sys.executable, "-m", "mavproxy_fault.cli", "proxy", "--zenoh", url]
        command += ["--run", "asked", "--master", "udpin:127.0.0.1:0"]
        command += ["--to", f"udpout:127.0.0.1:{station.getsockname()[1]}"]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert process.stdout is not None
        vehicle.connect(("127.0.0.1", int(process.stdout.readline().split()[1].rsplit(":", 1)[1])))
        try:
            refused, answered = ask_all(url, process, vehicle, station)
            process.send_signal(signal.SIGTERM)
            process.communicate(timeout=60)
        finally:
            process.kill()  # no harm where it has ended
            process.communicate()
        assert process.returncode == 0
    assert min(refused, answered) > QUERIES // 10
    print(f"{QUERIES} queries: {answered} answered, {refused} refused")


def ask_all(
    url: str, process: subprocess.Popen[str], vehicle: socket.socket, station: socket.socket
) -> tuple[int, int]:
    """How many queries were refused and how many answered."""
    rng = random.Random(12)
    refused = answered = 0
    with open_bus(url, run="asked") as bus:
        for number in range(QUERIES):
            what, payload = query(rng)
            text = answer(bus, what, payload)
            assert "because of a bug" not in text, (what, payload)
            assert text != "Timeout", (what, payload)
            assert process.poll() is None
            refused += bool(text) and text[0] not in "{["
            answered += text[:1] in ("{", "[")
            if number % 20 == 0:  # faults that lose frames may be armed: they end first
                bus.query("@ctl/schedule/stop", timeout_s=60)
                mark = build_frame(message_layout("HEARTBEAT"), {"custom_mode": number}, system=42)
                vehicle.send(mark)
                while mark not in station.recv(65_535):
                    pass
    return refused, answered

"""Payloads on Zenoh match docs/zenoh.schema.json."""

import json
import math
import queue
import runpy
import signal
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import jsonschema
import msgspec

from analysis.results import AttitudeError, encode
from mavproxy_fault.links.bus import choose_free_port, open_bus
from mavproxy_fault.proxy.core import Core
from mavproxy_fault.proxy.interfaces import LinkRole
from mavproxy_fault.proxy.statistics import link_statistics
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import build_frame

DOCS = Path(__file__).parents[3] / "docs"
FAULT = b'{"fault": "bias", "target": "SYSTEM_TIME.time_unix_usec", "value": 1}'
WRITTEN = runpy.run_path(str(DOCS / "write_schemas.py"))


def valid(key: str, data: bytes) -> dict[str, Any]:
    """Validate a payload with the published schema of its key, and return the key."""
    published = json.loads((DOCS / "zenoh.schema.json").read_text(encoding="utf-8"))
    check = {**published["keys"][key], "$defs": published["$defs"]}
    jsonschema.validate(json.loads(data), check)
    return check


def test_the_published_schema_is_that_of_the_sources() -> None:
    published = (DOCS / "zenoh.schema.json").read_text(encoding="utf-8")
    assert WRITTEN["text"]() == published, "run python docs/write_schemas.py"


def test_the_page_lists_exactly_the_published_keys() -> None:
    page = (DOCS / "zenoh.md").read_text(encoding="utf-8")
    rows = [line.split("`")[1] for line in page.splitlines() if line.startswith("| `")]
    assert set(WRITTEN["KEYS"]) == set(rows) - {"alive/{component}", "@ctl/..."}


def test_a_number_that_is_not_finite_is_null_and_valid() -> None:
    error = AttitudeError(
        t_us=1, estimator="ekf", roll=math.nan, pitch=0.0, yaw=0.0, angle=math.inf
    )
    valid("att/{estimator}/score", encode(error))


def test_counters_of_a_run_without_sockets_are_valid() -> None:
    core = Core([LinkRole("simulator", "to-vehicle")])
    # As `ProxiedFlight.stats` returns it.
    valid("proxy/stats", msgspec.json.encode([{**link_statistics(core, 0), "chunks_out": 0}]))


def test_payloads_of_a_running_proxy_are_valid(tmp_path: Path) -> None:
    url = choose_free_port("tcp/127.0.0.1:0")
    command = [sys.executable, "-m", "mavproxy_fault.cli", "proxy", "--zenoh", url]
    wanted = {key for key in WRITTEN["KEYS"] if key.startswith(("proxy/", "schedule/"))}
    messages: queue.Queue[tuple[str, bytes]] = queue.Queue()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle:
        command += ["--master", "udpin:127.0.0.1:0", "--to", "udpout:127.0.0.1:9"]
        command += ["--logdir", str(tmp_path)]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert process.stdout is not None
        try:
            port = int(process.stdout.readline().split()[1].rsplit(":", 1)[1])
            with open_bus(url) as bus:
                bus.subscribe("**", lambda key, data: messages.put((key, data)))
                bus.query("@ctl/fault/step/arm", FAULT)
                bus.query("@ctl/watch", b'["SYSTEM_TIME"]')
                found = {}
                while wanted - set(found):
                    values = {"time_unix_usec": 0, "time_boot_ms": 1000 + len(found)}
                    frame = build_frame(
                        message_layout("SYSTEM_TIME"), values, system=1, component=1
                    )
                    vehicle.sendto(frame, ("127.0.0.1", port))
                    key, data = messages.get(timeout=20)
                    found[key.split("/", 3)[3]] = data
        finally:
            process.send_signal(signal.SIGINT)
            process.communicate(timeout=20)
    # Every published key is listed.
    assert set(found) == wanted
    for key in wanted:
        check = valid(key, found[key])
        assert not jsonschema.Draft202012Validator(check).is_valid({"another": 1}), key

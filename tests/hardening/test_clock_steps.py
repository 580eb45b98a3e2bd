"""The wall clock is set an hour ahead and back while frames pass, without any delay or error.

Python's own clock is always tested. With libfaketime (Debian's `faketime`; `FAKETIME_LIBRARY` names
another path) the entire process has such a clock, including Zenoh and compiled code.
"""

import json
from itertools import pairwise
from pathlib import Path

import pytest

from mavproxy_fault.links.bus import choose_free_port, open_bus
from mavproxy_fault.wire.label import read_labels
from mavproxy_fault.wire.tlog import read_records
from tests.hardening.proxy_process import CLOCK_LIBRARY, driven

FRAMES, STEP = 1500, 250  # a frame is a millisecond of the vehicle's clock
SCHEDULE = """
seed: 1
faults:
  - {id: bias, fault: bias, target: ATTITUDE.roll, value: 0.5, at_s: 0.3, for_s: 0.4}
  - {id: late, fault: delay, target: ATTITUDE, value: 0.002, at_s: 0.8, for_s: 0.2}
"""
STEPPED = """
import os, time
def ahead_s():
    with open(os.environ["FAKETIME_TIMESTAMP_FILE"]) as file:
        return float(file.read())
now, now_ns = time.time, time.time_ns
time.time = lambda: now() + ahead_s()
time.time_ns = lambda: now_ns() + round(ahead_s() * 1e9)
"""


def environment(kind: str, folder: Path) -> dict[str, str]:
    """The environment that gives a process a clock set by a file."""
    (folder / "ahead").write_text("+0")
    variables = {"FAKETIME_TIMESTAMP_FILE": str(folder / "ahead")}
    if kind == "libfaketime":
        if not CLOCK_LIBRARY:
            pytest.skip("libfaketime is not there")
        # Read at every call; the monotonic clock cannot be set.
        return {
            **variables, "LD_PRELOAD": CLOCK_LIBRARY, "FAKETIME_NO_CACHE": "1",
            "DONT_FAKE_MONOTONIC": "1", "FAKETIME_DONT_FAKE_MONOTONIC": "1",
        }  # fmt: skip
    (folder / "sitecustomize.py").write_text(STEPPED)
    return {**variables, "PYTHONPATH": str(folder)}


@pytest.mark.parametrize("kind", ["python", "libfaketime"])
def test_setting_the_clock_affects_no_frame_label_or_record(kind: str, tmp_path: Path) -> None:
    (tmp_path / "one.yaml").write_text(SCHEDULE)
    url, logs = choose_free_port("tcp/127.0.0.1:0"), tmp_path / "logs"
    options = ("--schedule", str(tmp_path / "one.yaml"), "--logdir", str(logs), "--zenoh", url)
    states = []
    with (
        driven(*options, "--run", "stepped", **environment(kind, tmp_path)) as proxy,
        open_bus(url, run="stepped") as bus,
    ):
        for number in range(FRAMES):
            proxy.pass_frame()
            if number % STEP == 0:
                # An hour ahead, then two back, and so on: queries are answered throughout.
                (tmp_path / "ahead").write_text("-3600" if number % (2 * STEP) else "+3600")
                (reply,) = bus.query("@ctl/state", timeout_s=60)
                states.append(json.loads(reply))
        printed, errors = proxy.end()
    assert errors == ""
    received, sent = (
        [(t_us, raw) for t_us, raw, _ in read_records(logs / f"{name}.tlog") if raw[7] == 30]
        for name in ("received", "sent")
    )
    assert len(received) == len(sent) == FRAMES
    for records in (received, sent):
        # The clock went back by two hours: the timestamps of the recording continue.
        assert all(0 <= b - a < 1_800_000_000 for (a, _), (b, _) in pairwise(records))
    labels = {label.id: label for label in read_labels(logs / "labels.jsonl")}
    t0_us = labels["bias"].t0_us
    assert (labels["bias"].start_us - t0_us, labels["bias"].frames) == (300_000, 400)
    assert (labels["late"].start_us - t0_us, labels["late"].frames) == (800_000, 200)
    assert [state["t0_us"] for state in states[1:]] == [t0_us] * (FRAMES // STEP - 1)
    assert printed.splitlines()[1].split()[2] == str(FRAMES)

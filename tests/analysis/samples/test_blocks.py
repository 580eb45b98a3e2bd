"""Frames give the same samples one by one, in blocks, or from a log."""

from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from analysis.monitor.monitor import Monitor
from analysis.monitor.pipeline import MonitorConfig, monitor_config
from analysis.recordings.read_recordings import read_log
from analysis.results import Result, encode
from analysis.run.proxied_flight import ProxiedFlight
from analysis.run.run_setup import read_setup
from analysis.samples.block import block_of, split_at_events
from analysis.samples.sample import GpsFix, IonosphereSample
from mavproxy_fault.wire import tlog

SECONDS = 4.0
CONFIG = {"attitude": {"estimators": ["ekf", "complementary"]}}


@pytest.fixture(scope="module")
def frames() -> list[bytes]:
    """What the demo's vehicle sends in its first seconds, HIL frames and those of its autopilot."""
    setup = read_setup(None, None, None)
    flight = ProxiedFlight(setup.scenario, setup.schedule)
    sent: list[bytes] = []
    while flight.t_us < SECONDS * 1e6:
        chunks = flight.advance([])
        sent += [chunks.monitor, *chunks.ground]
    return [chunk for chunk in sent if chunk]


def config() -> MonitorConfig:
    return monitor_config(CONFIG, "test")


def lines(results: list[Result]) -> list[bytes]:
    return [encode(result) for result in results]


@pytest.fixture(scope="module")
def at_once(frames: list[bytes]) -> list[bytes]:
    return lines(Monitor(config()).push_bytes(frames, datagrams=False))


def test_the_compared_streams_hold_samples(at_once: list[bytes]):
    text = b"".join(at_once)
    wanted = (b'"Decision"', b'"baro"', b'"gps-position"', b'"ekf"', b'"complementary"')
    assert all(name in text for name in wanted)


@settings(max_examples=6)
@given(st.data())
def test_a_stream_split_anywhere_gives_the_same_samples(frames, at_once, data):
    cuts = data.draw(st.sets(st.integers(1, len(frames) - 1), max_size=40))
    monitor, found = Monitor(config()), []
    for begin, end in pairwise([0, *sorted(cuts), len(frames)]):
        found += lines(monitor.push_bytes(frames[begin:end], datagrams=False))
    assert found == at_once


def test_single_frames_give_the_same_samples(frames, at_once):
    monitor = Monitor(config())
    found = [
        line for frame in frames for line in lines(monitor.push_bytes([frame], datagrams=False))
    ]
    assert found == at_once


def test_a_log_of_the_stream_gives_the_same_samples(frames, at_once, tmp_path: Path):
    path = tmp_path / "flight.tlog"
    path.write_bytes(b"".join(tlog.log_record(1_700_000_000_000_000, frame) for frame in frames))
    monitor = Monitor(config())
    assert lines([result for block in read_log(path) for result in monitor.push(block)]) == at_once


def test_a_block_gives_back_the_samples_it_was_made_of(frames, tmp_path: Path):
    path = tmp_path / "flight.tlog"
    path.write_bytes(b"".join(tlog.log_record(0, frame) for frame in frames))
    (block,) = read_log(path)
    again = block_of(block.samples())
    assert (again.kind == block.kind).all()
    assert (again.t_us == block.t_us).all()
    assert (again.values == block.values)[block.values == block.values].all()
    assert again.beside == block.beside


def test_each_event_ends_a_slice():
    fixes = [GpsFix(t, 0.0, 0.0, 0.0, None, 3, 9, 1.0, 1.0, "HIL_GPS") for t in range(4)]
    broadcast = IonosphereSample(9, (0.0,) * 4, (0.0,) * 4)
    block = block_of([fixes[0], fixes[1], broadcast, fixes[2], fixes[3]])
    assert [(p.first, p.last) for p in split_at_events(block)] == [(n, n) for n in range(5)]

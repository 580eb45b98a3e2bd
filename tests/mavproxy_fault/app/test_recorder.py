import json
import warnings
from pathlib import Path

from mavproxy_fault.app.playback import split
from mavproxy_fault.app.recorder import Recorder
from mavproxy_fault.proxy.tape import Tape
from mavproxy_fault.wire.dialect import known
from mavproxy_fault.wire.frame import build
from mavproxy_fault.wire.label import Label, read_labels

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    from pymavlink import mavutil

WALL_US = 1_700_000_000_000_000


def heartbeat(seq: int) -> bytes:
    return build(known("HEARTBEAT"), {"type": 2, "mavlink_version": 3}, seq=seq)


def test_a_session_can_be_read_before_it_is_closed(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, {"seed": 3})
    tape = Tape()
    tape.receive(WALL_US, 1, heartbeat(0))
    tape.send(WALL_US + 5, heartbeat(0))
    recorder.write(tape, [Label(id="a", fault="bias", t0_us=0, start_us=1)])
    assert list(split((tmp_path / "received.tlog").read_bytes())) == [(WALL_US, heartbeat(0))]
    assert list(split((tmp_path / "sent.tlog").read_bytes())) == [(WALL_US + 5, heartbeat(0))]
    assert [label.id for label in read_labels(tmp_path / "labels.jsonl")] == ["a"]
    recorder.close(7, WALL_US + 9)
    session = json.loads((tmp_path / "session.json").read_text())
    assert session == {"seed": 3, "t0_us": 7, "end_us": WALL_US + 9}


def test_an_earlier_session_is_set_aside_and_never_overwritten(tmp_path: Path) -> None:
    for number in range(3):
        Recorder(tmp_path, {"seed": number}).close(None, 0)
    seeds = [
        json.loads((tmp_path / folder / "session.json").read_text())["seed"]
        for folder in ("earlier-1", "earlier-2", ".")
    ]
    assert seeds == [0, 1, 2]


def test_bytes_that_are_no_frame_hide_no_frame_from_readers_of_the_log(tmp_path: Path) -> None:
    tape = Tape()
    frames = [heartbeat(seq) for seq in range(40)]
    for number, raw in enumerate(frames):
        tape.send(WALL_US + number * 1000, raw)
        broken = raw[:-1] + b"\0"
        tape.send(WALL_US + number * 1000 + 1, (b"boot: fine\r\n", broken)[number % 2])
    path = tmp_path / "sent.tlog"
    path.write_bytes(tape.take().sent)
    ours = [raw for _, raw in split(path.read_bytes())]
    assert [raw for raw in ours if raw in frames] == frames
    log = mavutil.mavlink_connection(str(path))
    theirs = 0
    while (message := log.recv_match()) is not None:
        theirs += message.get_type() == "HEARTBEAT"
    log.close()
    assert theirs == 40

"""A scenario under an autopilot: recorded ones that die, and real ones if available.

A real ArduCopter flies if MAVPROXY_FAULT_ARDUPILOT names its SITL binary, a real PX4 if
MAVPROXY_FAULT_PX4 does.
"""

import contextlib
import gc
import json
import os
import select
import shutil
import signal
import subprocess
import sys
from html import escape
from pathlib import Path
from queue import Queue

import pytest

from analysis.autopilots.autopilot_run import keep_telemetry, real_time_priority
from analysis.recordings.flight_logs.ulog import read_ulog
from mavproxy_fault import cli
from mavproxy_fault.links.bus import choose_free_port, open_bus
from mavproxy_fault.schedule.entries import parse_entry, parse_schedule
from mavproxy_fault.wire.label import read_labels
from mavproxy_fault.wire.tlog import read_columns

STAND_IN = Path(__file__).parents[2] / "mavproxy_fault" / "ardupilot" / "recorded_autopilot.py"
PX4_STAND_IN = Path(__file__).with_name("recorded_px4.py")
SCENARIO = """
name: hover
duration_s: {duration_s}
vehicle: {{kind: multirotor, parameters: iris}}
sensors:
  imu: {{preset: consumer-mems, rate_hz: 400}}
  mag: {{preset: consumer-mag, rate_hz: 50}}
  baro: {{preset: consumer-baro, rate_hz: 50}}
  gps: {{preset: consumer, rate_hz: 5}}
schedule:
  faults: [{{id: gps, fault: bias, target: HIL_GPS.alt, value: 5000, at_s: 6, for_s: 3}}]
"""


IMU_HZ = {"ardupilot": 400, "px4": 250}


@pytest.fixture
def run(tmp_path):
    """Starts runs, and ends those that a test leaves behind."""
    with contextlib.ExitStack() as stack:

        def begin(*options, scenario=None, autopilot="ardupilot"):
            file = tmp_path / "hover.yaml"
            scenario = scenario or SCENARIO.format(duration_s=12)
            file.write_text(
                scenario.replace("rate_hz: 400", f"rate_hz: {IMU_HZ[autopilot.partition(':')[0]]}")
            )
            process = subprocess.Popen(
                [sys.executable, "-m", "mavproxy_fault.cli", "run", str(file),
                 "--autopilot", autopilot, "--out", str(tmp_path / "out"),
                 *(() if "--zenoh" in options else ("--zenoh", "off")), *options],
                stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
                start_new_session=True,
            )  # fmt: skip
            stack.enter_context(process)  # waits, and closes its output
            stack.callback(process.kill)
            return process

        yield begin


@pytest.fixture
def recorded_px4(tmp_path) -> str:
    """A build of PX4 whose binary is the stand-in."""
    binary = tmp_path / "px4" / "bin" / "px4"
    (binary.parent.parent / "etc" / "init.d-posix").mkdir(parents=True)
    (binary.parent.parent / "etc" / "init.d-posix" / "rcS").touch()
    binary.parent.mkdir()
    binary.write_text(f'#!/bin/sh\nexec {sys.executable} {PX4_STAND_IN} "$@"\n')
    binary.chmod(0o755)
    return str(binary)


def fly_until(process, text):
    """Read the output of the run until a line contains the text."""
    for line in process.stdout:
        if text in line:
            return
    raise AssertionError(f"the run did not print {text}")


@pytest.fixture
def px4() -> str:
    path = os.environ.get("MAVPROXY_FAULT_PX4")
    if path is None or shutil.which(path) is None:
        pytest.skip("no PX4; set MAVPROXY_FAULT_PX4 to its SITL binary")
    return path


@pytest.fixture
def arducopter() -> str:
    path = os.environ.get("MAVPROXY_FAULT_ARDUPILOT")
    if path is None or shutil.which(path) is None:
        pytest.skip("no ArduCopter; set MAVPROXY_FAULT_ARDUPILOT to its SITL binary")
    return path


def autopilot_of(process):
    """Return ArduCopter's process id, once the vehicle flies."""
    fly_until(process, "flying")
    for number in children(process.pid):
        if "arducopter" in Path(f"/proc/{number}/comm").read_text():
            return number
    raise AssertionError("no autopilot is running")


def children(number):
    return [int(n) for n in Path(f"/proc/{number}/task/{number}/children").read_text().split()]


@pytest.mark.parametrize(
    ("options", "more", "message"),
    [
        (
            ("ardupilot", "--binary", "no-such-autopilot"),
            "",
            "--binary: 'no-such-autopilot' is not a program; give ArduPilot's SITL binary",
        ),
        (
            ("ardupilot", "--binary", sys.executable, "--from", "breakfast"),
            "",
            "--from breakfast: is not a flight event; known: first-stamp, arming",
        ),
        (
            ("ardupilot", "--binary", sys.executable),
            "start: {height_m: 30}\n",
            "start.height_m = 30 starts in the air",
        ),
        (
            ("ardupilot:plane", "--binary", "true"),
            "",
            "the scenario's vehicle is a multirotor; it needs arducopter",
        ),
    ],
)
def test_what_cannot_be_flown_is_refused_with_the_cure(tmp_path, capsys, options, more, message):
    file = tmp_path / "hover.yaml"
    file.write_text(SCENARIO.format(duration_s=12) + more)
    command = ["run", str(file), "--zenoh", "off", "--out", str(tmp_path / "out")]
    assert cli.main([*command, "--autopilot", *options]) == 2
    assert message in capsys.readouterr().err


def test_an_autopilot_that_dies_leaves_a_readable_folder_and_the_reason(tmp_path, run):
    binary = tmp_path / "autopilot.sh"
    binary.write_text(f'#!/bin/sh\nexec {sys.executable} {STAND_IN} "$@"\n')
    binary.chmod(0o755)
    process = run("--binary", str(binary))
    output, _ = process.communicate(timeout=240)
    assert process.returncode == 1
    assert "the flight ended early: " in output
    assert "the autopilot process ended with exit code 3" in output
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert not summary["autopilot"]["landed"]
    assert summary["verdict"] == "FAIL"
    (unmet,) = [check for check in summary["criteria"] if not check["passed"]]
    assert unmet["name"] == "flight completed"
    assert unmet["value"] == summary["autopilot"]["ended_early"]
    assert escape(unmet["value"]) in (tmp_path / "out" / "report.html").read_text()
    assert len(read_columns(tmp_path / "out" / "sent.tlog")["HIL_ACTUATOR_CONTROLS"]) > 100


def test_a_real_arducopter_takes_off_meets_the_fault_and_lands(tmp_path, arducopter, run):
    process = run("--binary", arducopter)
    output, _ = process.communicate(timeout=600)
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    flown = summary["autopilot"]
    assert flown["landed"], output
    (fault,) = summary["faults"]
    first_s = flown["moments_s"]["first-stamp"]
    assert fault["start_s"] == pytest.approx(
        flown["moments_s"]["take-off"] - first_s + 6.0, abs=0.3
    )
    assert fault["frames"] == 15
    columns = read_columns(tmp_path / "out" / "sent.tlog")
    heights_m = columns["HIL_STATE_QUATERNION"]["alt"] * 1e-3 - 488.0
    assert 9.0 < heights_m.max() < 13.0
    assert abs(heights_m[-1]) < 0.5
    assert list((tmp_path / "out" / "autopilot" / "logs").glob("*.BIN"))


def test_a_real_arducopter_killed_in_flight_is_reported(tmp_path, arducopter, run):
    process = run("--binary", arducopter, scenario=SCENARIO.format(duration_s=600))
    os.kill(autopilot_of(process), signal.SIGKILL)
    output, _ = process.communicate(timeout=240)
    assert process.returncode == 1
    assert "ArduPilot ended by signal 9" in output
    assert "the flight ended early: " in output
    assert (tmp_path / "out" / "report.html").exists()


def test_a_run_killed_in_flight_ends_its_arducopter(tmp_path, arducopter, run):
    process = run("--binary", arducopter, scenario=SCENARIO.format(duration_s=600))
    with open(os.pidfd_open(autopilot_of(process)), "rb", buffering=0) as autopilot:
        process.kill()
        process.communicate(timeout=240)
        ended, _, _ = select.select([autopilot], [], [], 240)
    assert ended
    assert len(read_columns(tmp_path / "out" / "sent.tlog")["HIL_STATE_QUATERNION"]) > 900


def test_a_px4_that_dies_leaves_a_readable_folder_and_the_reason(tmp_path, recorded_px4, run):
    process = run("--binary", recorded_px4, "--no-report", autopilot="px4")
    output, _ = process.communicate(timeout=240)
    assert process.returncode == 1
    assert not (tmp_path / "out" / "report.html").exists()
    assert "the autopilot closed the link" in output
    assert "last output of PX4: " in output
    assert " | there is no more" in output
    assert "Traceback" not in output
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert not summary["autopilot"]["landed"]
    assert [text for _, text in summary["autopilot"]["texts"]]  # of the recorded telemetry
    assert len(read_columns(tmp_path / "out" / "sent.tlog")["HIL_ACTUATOR_CONTROLS"]) == 949


def test_a_px4_that_does_not_start_is_reported_with_its_reason(tmp_path, run):
    (program := tmp_path / "bin" / "px4").parent.mkdir()
    (script := tmp_path / "etc" / "init.d-posix" / "rcS").parent.mkdir(parents=True)
    script.touch()
    program.write_text("#!/bin/sh\nfor i in 1 2 3 4; do echo no socket; done; echo over; exit 3\n")
    program.chmod(0o755)
    process = run("--binary", program, "--no-report", autopilot="px4")
    output, _ = process.communicate(timeout=240)
    assert "ended with code 3 before it connected; last output of PX4: no socket | over" in output
    assert "battery" not in output


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_request_to_stop_ends_the_flight_with_a_report(tmp_path, recorded_px4, number, run):
    process = run("--binary", recorded_px4, "--speed", "0.5", autopilot="px4")
    fly_until(process, "in lockstep")
    os.killpg(process.pid, number)  # as a terminal and a container do
    output, _ = process.communicate(timeout=240)
    assert process.returncode == 1, output
    assert "the flight ended early: stopped" in output
    assert "Traceback" not in output
    assert (tmp_path / "out" / "report.html").exists()


def test_a_flight_is_published_and_faults_are_armed_over_the_bus(tmp_path, recorded_px4, run):
    url = choose_free_port("tcp/127.0.0.1:0")
    options = ("--binary", recorded_px4, "--speed", "0.5", "--zenoh", url, "--no-report")
    process = run(*options, autopilot="px4")
    fly_until(process, "in lockstep")
    with open_bus(url, run="out") as bus:
        states: Queue[bytes] = Queue()
        bus.subscribe("schedule/state", lambda _, payload: states.put(payload))
        entry = {"fault": "bias", "target": "HIL_SENSOR.xgyro", "value": 0.5}
        (answer,) = bus.query("@ctl/fault/live/arm", json.dumps(entry).encode(), 60.0)
        assert json.loads(answer)["armed"] == ["live"]
        while b'"live"' not in states.get(timeout=60.0):
            pass
    os.killpg(process.pid, signal.SIGINT)
    output, _ = process.communicate(timeout=240)
    assert "the flight ended early: stopped" in output
    (label,) = read_labels(tmp_path / "out" / "labels.jsonl")
    assert label.id == "live"
    assert label.frames > 0
    # Edits over the bus are reported, but not the loading of the schedule.
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    (line,) = summary["edited"]
    assert " s fault/live/arm {" in line
    assert "edited live" in output


def test_a_killed_run_ends_all_its_processes_and_leaves_its_logs(tmp_path, recorded_px4, run):
    process = run("--binary", f"{recorded_px4} --stays", autopilot="px4")
    fly_until(process, "no answer to the step")
    descriptors = [os.pidfd_open(number) for number in children(process.pid)]
    process.kill()
    process.communicate(timeout=60)
    for descriptor in descriptors:
        assert select.select([descriptor], [], [], 30.0)[0], "a process outlives the run"
        os.close(descriptor)
    assert len(read_columns(tmp_path / "out" / "sent.tlog")["HIL_STATE_QUATERNION"]) > 900


def test_a_real_px4_takes_off_meets_the_fault_and_lands(tmp_path, px4, run):
    process = run("--binary", px4, autopilot="px4")
    output, _ = process.communicate(timeout=600)
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["autopilot"]["landed"], output
    (fault,) = summary["faults"]
    assert fault["frames"] == 15
    columns = read_columns(tmp_path / "out" / "sent.tlog")
    heights_m = columns["HIL_STATE_QUATERNION"]["alt"] * 1e-3 - 488.0
    assert 9.0 < heights_m.max() < 17.0  # the GPS reports 5 m more for a while
    assert abs(heights_m[-1]) < 0.5
    (log,) = (tmp_path / "out" / "autopilot" / "log").glob("*/*.ulg")
    # PX4's start script, whose last lines start the logger, ends before arming.
    assert read_ulog(log).start_us * 1e-6 < summary["autopilot"]["moments_s"]["arming"]


def test_a_real_px4_killed_in_flight_is_reported(tmp_path, px4, run):
    scenario = SCENARIO.format(duration_s=600)
    process = run("--binary", px4, scenario=scenario, autopilot="px4")
    fly_until(process, "flying")
    (autopilot,) = (
        number
        for number in children(process.pid)
        if "px4" in Path(f"/proc/{number}/comm").read_text()
    )
    os.kill(autopilot, signal.SIGKILL)
    output, _ = process.communicate(timeout=240)
    assert process.returncode == 1
    assert "PX4 ended by signal 9" in output
    assert (tmp_path / "out" / "report.html").exists()


def test_the_flight_has_priority_over_other_threads_of_the_autopilot():
    before = os.sched_getscheduler(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(1))
        os.sched_setscheduler(0, before, os.sched_param(0))
    except PermissionError:
        pytest.skip("real-time priorities are not allowed here")
    with real_time_priority():
        assert os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO
        child = subprocess.run(
            [sys.executable, "-c", "import os; print(os.sched_getscheduler(0))"],
            capture_output=True, text=True, check=True,
        )  # fmt: skip
    assert int(child.stdout) == before
    assert os.sched_getscheduler(0) == before


def test_the_priority_is_restored_without_permission_to_clear_reset_on_fork(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    policies: list[int] = []

    def allow(pid: int, policy: int, param: object) -> None:
        if policies and not policy & os.SCHED_RESET_ON_FORK:
            raise PermissionError
        policies.append(policy)

    monkeypatch.setattr(os, "sched_setscheduler", allow)
    with real_time_priority():
        pass
    assert policies[-1] & ~os.SCHED_RESET_ON_FORK == os.sched_getscheduler(0)


@pytest.mark.parametrize("missing", [False, True])
def test_without_permission_for_a_real_time_priority_the_flight_continues(
    monkeypatch: pytest.MonkeyPatch, missing: bool
) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError

    if missing:  # as on systems without these calls
        monkeypatch.delattr(os, "sched_getscheduler")
    else:
        monkeypatch.setattr(os, "sched_setscheduler", refuse)
    with real_time_priority():
        assert gc.get_freeze_count() > 0
    assert gc.get_freeze_count() == 0


def test_a_preset_of_a_sensor_leaves_the_autopilot_s_own_telemetry_alone() -> None:
    def direction(**entry):
        (found,) = parse_schedule({"faults": [{"at_s": 1, **entry}]}).faults
        kept = keep_telemetry(found)
        assert parse_entry(dict(kept.written), "saved")[0].where == kept.where
        return kept.where.direction

    assert direction(preset="gps-jump") == "to-vehicle"
    assert direction(preset="motor-failure") is None
    assert direction(preset="communication-interrupted") is None
    assert direction(fault="bias", target="GLOBAL_POSITION_INT.lat", value=9) is None

"""A scenario under an autopilot: recorded ones that die, and real ones where there are any.

A real ArduCopter is flown where MAVPROXY_FAULT_ARDUPILOT names its SITL program, a real PX4 where
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

from analysis.autopilots.autopilot_run import real_time_priority
from analysis.recordings.flight_logs.ulog import read_ulog
from mavproxy_fault.links.bus import choose_free_port, open_bus
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
    """Begins runs; those that a test leaves behind end with it."""
    with contextlib.ExitStack() as stack:

        def begin(*options, scenario=None, autopilot="ardupilot"):
            file = tmp_path / "hover.yaml"
            scenario = scenario or SCENARIO.format(duration_s=12)
            file.write_text(
                scenario.replace("rate_hz: 400", f"rate_hz: {IMU_HZ[autopilot.partition(':')[0]]}")
            )
            process = subprocess.Popen(
                [sys.executable, "-m", "mavproxy_fault.cli", "run", str(file),
                 "--autopilot", autopilot, "--zenoh", "off", "--out", str(tmp_path / "out"),
                 *options],
                stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
                start_new_session=True,
            )  # fmt: skip
            stack.enter_context(process)  # waits, and closes what it said
            stack.callback(process.kill)
            return process

        yield begin


@pytest.fixture
def recorded_px4(tmp_path) -> str:
    """A build of PX4 whose program is the stand-in."""
    program = tmp_path / "px4" / "bin" / "px4"
    (program.parent.parent / "etc" / "init.d-posix").mkdir(parents=True)
    (program.parent.parent / "etc" / "init.d-posix" / "rcS").touch()
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\nexec {sys.executable} {PX4_STAND_IN} "$@"\n')
    program.chmod(0o755)
    return str(program)


def fly_until(process, word):
    """Read what the run says until a word is in it."""
    for line in process.stdout:
        if word in line:
            return
    raise AssertionError(f"it never said {word}")


@pytest.fixture
def px4() -> str:
    path = os.environ.get("MAVPROXY_FAULT_PX4")
    if path is None or shutil.which(path) is None:
        pytest.skip("no PX4; set MAVPROXY_FAULT_PX4 to its SITL program")
    return path


@pytest.fixture
def arducopter() -> str:
    path = os.environ.get("MAVPROXY_FAULT_ARDUPILOT")
    if path is None or shutil.which(path) is None:
        pytest.skip("no ArduCopter; set MAVPROXY_FAULT_ARDUPILOT to its SITL program")
    return path


def autopilot_of(process):
    """ArduCopter's process id, once the vehicle flies."""
    fly_until(process, "flying")
    for number in children(process.pid):
        if "arducopter" in Path(f"/proc/{number}/comm").read_text():
            return number
    raise AssertionError("no autopilot is running")


def children(number):
    return [int(n) for n in Path(f"/proc/{number}/task/{number}/children").read_text().split()]


def test_a_missing_program_is_told_with_what_to_do(run):
    process = run("--binary", "no-such-autopilot")
    said, _ = process.communicate(timeout=60)
    assert process.returncode == 2
    assert "--binary: 'no-such-autopilot' is not a program; give ArduPilot's SITL binary" in said


def test_a_moment_that_no_flight_has_is_refused(run):
    process = run("--binary", sys.executable, "--from", "breakfast")
    said, _ = process.communicate(timeout=60)
    assert process.returncode == 2
    assert "--from breakfast: is no moment of a flight; known: first-stamp, arming" in said


def test_a_start_in_the_air_is_refused(run):
    scenario = SCENARIO.format(duration_s=12) + "start: {height_m: 30}\n"
    process = run("--binary", sys.executable, scenario=scenario)
    said, _ = process.communicate(timeout=60)
    assert process.returncode == 2
    assert "start.height_m = 30 is in the air" in said


def test_a_vehicle_that_is_not_the_scenarios_is_refused(run):
    process = run("--binary", "true", autopilot="ardupilot:plane")
    said, _ = process.communicate(timeout=60)
    assert process.returncode == 2
    assert "the scenario's vehicle is a multirotor, which arducopter flies" in said


def test_an_autopilot_that_dies_leaves_a_readable_folder_and_the_reason(tmp_path, run):
    program = tmp_path / "autopilot.sh"
    program.write_text(f'#!/bin/sh\nexec {sys.executable} {STAND_IN} "$@"\n')
    program.chmod(0o755)
    process = run("--binary", str(program))
    said, _ = process.communicate(timeout=240)
    assert process.returncode == 1
    assert "the flight ended early: " in said
    assert "the autopilot process ended with exit code 3" in said
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert not summary["autopilot"]["landed"]
    assert summary["verdict"] == "FAIL"
    (unmet,) = [check for check in summary["criteria"] if not check["passed"]]
    assert unmet["name"] == "flown to the landing"
    assert unmet["value"] == summary["autopilot"]["ended_early"]
    assert escape(unmet["value"]) in (tmp_path / "out" / "report.html").read_text()
    assert len(read_columns(tmp_path / "out" / "sent.tlog")["HIL_ACTUATOR_CONTROLS"]) > 100


def test_a_real_arducopter_takes_off_meets_the_fault_and_lands(tmp_path, arducopter, run):
    process = run("--binary", arducopter)
    said, _ = process.communicate(timeout=600)
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    flown = summary["autopilot"]
    assert flown["landed"], said
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


def test_a_real_arducopter_killed_in_flight_is_told(tmp_path, arducopter, run):
    process = run("--binary", arducopter, scenario=SCENARIO.format(duration_s=600))
    os.kill(autopilot_of(process), signal.SIGKILL)
    said, _ = process.communicate(timeout=240)
    assert process.returncode == 1
    assert "ArduPilot ended by signal 9" in said
    assert "the flight ended early: " in said
    assert (tmp_path / "out" / "report.html").exists()


def test_a_run_killed_in_flight_takes_its_arducopter_along(tmp_path, arducopter, run):
    process = run("--binary", arducopter, scenario=SCENARIO.format(duration_s=600))
    with open(os.pidfd_open(autopilot_of(process)), "rb", buffering=0) as autopilot:
        process.kill()
        process.communicate(timeout=240)
        ended, _, _ = select.select([autopilot], [], [], 240)
    assert ended
    assert len(read_columns(tmp_path / "out" / "sent.tlog")["HIL_STATE_QUATERNION"]) > 900


def test_a_px4_that_dies_leaves_a_readable_folder_and_the_reason(tmp_path, recorded_px4, run):
    process = run("--binary", recorded_px4, "--no-report", autopilot="px4")
    said, _ = process.communicate(timeout=240)
    assert process.returncode == 1
    assert not (tmp_path / "out" / "report.html").exists()
    assert "the autopilot closed the link" in said
    assert "PX4 said: there is no more" in said
    assert "Traceback" not in said
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert not summary["autopilot"]["landed"]
    assert [text for _, text in summary["autopilot"]["texts"]]  # of the recorded telemetry
    assert len(read_columns(tmp_path / "out" / "sent.tlog")["HIL_ACTUATOR_CONTROLS"]) == 949


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_request_to_stop_ends_the_flight_with_a_report(tmp_path, recorded_px4, number, run):
    process = run("--binary", recorded_px4, "--speed", "0.5", autopilot="px4")
    fly_until(process, "in lockstep")
    os.killpg(process.pid, number)  # as a terminal and a container do
    said, _ = process.communicate(timeout=240)
    assert process.returncode == 1, said
    assert "the flight ended early: stopped" in said
    assert "Traceback" not in said
    assert (tmp_path / "out" / "report.html").exists()


def test_a_flight_is_watched_and_faulted_from_the_bus(tmp_path, recorded_px4, run):
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
    said, _ = process.communicate(timeout=240)
    assert "the flight ended early: stopped" in said
    (label,) = read_labels(tmp_path / "out" / "labels.jsonl")
    assert label.id == "live"
    assert label.frames > 0
    # What others asked for is told, and that the schedule began is not.
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    (line,) = summary["edited"]
    assert " s fault/live/arm {" in line
    assert "edited live" in said


def test_a_killed_run_takes_all_its_processes_along_and_leaves_its_logs(
    tmp_path, recorded_px4, run
):
    process = run("--binary", f"{recorded_px4} --stays", autopilot="px4")
    fly_until(process, "no answer to the step")
    watched = [os.pidfd_open(number) for number in children(process.pid)]
    process.kill()
    process.communicate(timeout=60)
    for descriptor in watched:
        assert select.select([descriptor], [], [], 30.0)[0], "a process outlives the run"
        os.close(descriptor)
    assert len(read_columns(tmp_path / "out" / "sent.tlog")["HIL_STATE_QUATERNION"]) > 900


def test_a_real_px4_takes_off_meets_the_fault_and_lands(tmp_path, px4, run):
    process = run("--binary", px4, autopilot="px4")
    said, _ = process.communicate(timeout=600)
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["autopilot"]["landed"], said
    (fault,) = summary["faults"]
    assert fault["frames"] == 15
    columns = read_columns(tmp_path / "out" / "sent.tlog")
    heights_m = columns["HIL_STATE_QUATERNION"]["alt"] * 1e-3 - 488.0
    assert 9.0 < heights_m.max() < 17.0  # the GPS tells it 5 m more for a while
    assert abs(heights_m[-1]) < 0.5
    (log,) = (tmp_path / "out" / "autopilot" / "log").glob("*/*.ulg")
    # PX4's start script, whose last lines start the logger, is over before anything is flown.
    assert read_ulog(log).start_us * 1e-6 < summary["autopilot"]["moments_s"]["arming"]


def test_a_real_px4_killed_in_flight_is_told(tmp_path, px4, run):
    scenario = SCENARIO.format(duration_s=600)
    process = run("--binary", px4, scenario=scenario, autopilot="px4")
    fly_until(process, "flying")
    (autopilot,) = (
        number
        for number in children(process.pid)
        if "px4" in Path(f"/proc/{number}/comm").read_text()
    )
    os.kill(autopilot, signal.SIGKILL)
    said, _ = process.communicate(timeout=240)
    assert process.returncode == 1
    assert "PX4 ended by signal 9" in said
    assert (tmp_path / "out" / "report.html").exists()


def test_a_flight_stands_before_what_an_autopilot_does_beside_it():
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


def test_a_user_who_may_not_drop_the_flag_about_forks_still_ends_a_flight(
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
def test_without_the_right_to_a_real_time_priority_a_flight_goes_on(
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


def test_an_autopilots_flight_has_no_twin(run):
    process = run("--against-clean")
    said, _ = process.communicate()
    assert process.returncode == 2
    assert "--against-clean: two flights of ardupilot differ" in said

"""A run starts PX4 with its command line, ports, streams and environment."""

import os
from contextlib import closing

import pytest

from analysis.autopilots.hil_exchange import BRIDGE_STEP, PX4_STEP
from analysis.autopilots.px4 import px4_process
from analysis.autopilots.running_autopilot import Pacer, RunningAutopilot
from mavproxy_fault.documents.errors import ConfigError
from simvehicle.scenario.scenario_file import read_scenario
from simvehicle.simulation.simulation import Simulation


@pytest.fixture
def binary(tmp_path):
    """The binary in a build of PX4, without its scripts yet."""
    binary = tmp_path / "build" / "bin" / "px4"
    binary.parent.mkdir(parents=True)
    binary.write_text("#!/bin/sh\n")
    binary.chmod(0o755)
    return binary


@pytest.fixture
def simulation(tmp_path):
    file = tmp_path / "hexa.yaml"
    file.write_text(
        "name: hexa\nvehicle: {kind: multirotor, parameters: hexa}\nsensors: {imu: {rate_hz: 250}}"
    )
    return Simulation(read_scenario(str(file)))


def test_a_missing_binary_is_reported_with_the_cure():
    with pytest.raises(ConfigError, match=r"--binary: 'no-px4' not found; give PX4's SITL"):
        px4_process.launch_command("no-px4")


def test_a_binary_without_its_start_scripts_is_refused(binary):
    with pytest.raises(ConfigError, match=r"has no .*/build/etc/init\.d-posix/rcS"):
        px4_process.launch_command(str(binary))


def test_the_start_scripts_are_found_from_the_binary(binary):
    scripts = binary.parent.parent / "etc"
    (scripts / "init.d-posix").mkdir(parents=True)
    (scripts / "init.d-posix" / "rcS").touch()
    assert px4_process.launch_command(str(binary)) == [str(binary), "-d", str(scripts)]


@pytest.mark.parametrize(("started_s", "limited_s"), [(3.0, 3.0), (None, 60.0)])
def test_the_speed_is_limited_until_the_start_script_has_ended(
    tmp_path, monkeypatch, started_s, limited_s
):
    now = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    monkeypatch.setattr("time.sleep", lambda seconds: now.__setitem__(0, now[0] + seconds))
    log = tmp_path / "px4.log"
    log.write_text("INFO  [px4] startup script: rcS 0\n")
    start = Pacer(RunningAutopilot("PX4", None, [], log, PX4_STEP, px4_process.STARTUP_TEXT))
    printed = started_s is None
    for tick in range(80_000):  # 320 s of a vehicle that takes no wall time
        start.wait_for_pace(1_000_000 + 4000 * tick, careful=False)
        if not printed and now[0] >= 100.0 + started_s:
            printed = log.write_text("INFO  [px4] Startup script returned successfully\n") > 0
    assert now[0] - 100.0 == pytest.approx(limited_s, abs=0.2)


def test_the_speed_is_not_limited_for_an_autopilot_without_startup_text(tmp_path, monkeypatch):
    monkeypatch.setattr("time.sleep", lambda seconds: pytest.fail("slept"))
    start = Pacer(RunningAutopilot("ArduPilot", None, [], tmp_path / "none", BRIDGE_STEP))
    start.wait_for_pace(0, careful=False)
    start.wait_for_pace(10_000_000, careful=False)


def test_the_speed_is_limited_while_a_mission_is_transferred(tmp_path, monkeypatch):
    now = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    monkeypatch.setattr("time.sleep", lambda seconds: now.__setitem__(0, now[0] + seconds))
    pacer = Pacer(RunningAutopilot("ArduPilot", None, [], tmp_path / "none", BRIDGE_STEP))
    for t_us in range(0, 60_000_000, 4000):  # a transfer from 20 to 24 and from 40 to 44 s
        pacer.wait_for_pace(t_us, careful=t_us % 20_000_000 < 4_000_000 <= t_us)
    assert now[0] - 100.0 == pytest.approx(2 * 4.0 / 4.0, abs=0.1)


def test_two_runs_at_once_are_two_instances():
    first, one = px4_process.open_free_instance()
    with closing(one):
        second, other = px4_process.open_free_instance()
        with closing(other):
            assert second > first
            assert (one.port, other.port) == (4560 + first, 4560 + second)


def test_the_streams_go_to_the_run_on_the_loopback_address():
    lines = px4_process.stream_script(18_000, 14_000).splitlines()
    assert lines[0].startswith("mavlink start -x -u 18000 -o 14000 -t 127.0.0.1 ")
    assert "mavlink stream -u 18000 -s ATTITUDE -r 20" in lines


def test_the_run_folder_comes_first_in_the_path_and_other_simulators_are_left_out(
    simulation, tmp_path, monkeypatch
):
    monkeypatch.setenv("PX4_SIMULATOR", "gz")
    overrides = {"EKF2_GPS_P_GATE": 100.0, "MIS_TAKEOFF_ALT": 7.25}
    variables = px4_process.process_environment(simulation, tmp_path, overrides)
    assert "PX4_SIMULATOR" not in variables
    assert variables["PATH"].split(os.pathsep)[0] == str(tmp_path)
    assert variables["PX4_SIM_MODEL"] == "none_iris"
    assert variables["PX4_PARAM_CA_ROTOR_COUNT"] == "6"
    assert variables["PX4_PARAM_EKF2_GPS_P_GATE"] == "100"
    assert variables["PX4_PARAM_MIS_TAKEOFF_ALT"] == "7.25"  # the user's override

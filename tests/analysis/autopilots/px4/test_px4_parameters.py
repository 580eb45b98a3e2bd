"""PX4 parameters of a vehicle, compared with PX4's own airframe."""

import pytest

from analysis.autopilots.px4.px4_parameters import rotor_parameters, run_parameters
from simvehicle.scenario.scenario_file import read_scenario
from simvehicle.simulation.simulation import Simulation


def simulation(tmp_path, kind, name):
    file = tmp_path / "scenario.yaml"
    file.write_text(
        f"name: it\nvehicle: {{kind: {kind}, parameters: {name}}}\nsensors: {{imu: {{}}}}"
    )
    return Simulation(read_scenario(str(file)))


def test_the_motors_of_a_quad_are_those_of_px4s_own_airframe(tmp_path):
    found = rotor_parameters(simulation(tmp_path, "multirotor", "iris").vehicle)
    signs = [
        tuple(found[f"CA_ROTOR{number}_{name}"] > 0 for name in ("PX", "PY", "KM"))
        for number in range(4)
    ]
    # none_iris (10016): front right and rear left turn counter-clockwise, positive in PX4
    assert signs == [
        (True, True, True),
        (False, False, True),
        (True, False, False),
        (False, True, False),
    ]
    assert [found[f"PWM_MAIN_FUNC{number}"] for number in range(1, 5)] == [101, 102, 103, 104]


def test_every_rotor_of_a_hexa_has_its_parameters(tmp_path):
    found = rotor_parameters(simulation(tmp_path, "multirotor", "hexa").vehicle)
    assert found["CA_ROTOR_COUNT"] == 6
    assert found["CA_ROTOR1_PY"] == pytest.approx(-0.3)
    assert found["CA_ROTOR5_KM"] == pytest.approx(-0.06)


def test_a_plane_takes_off_to_the_plans_height_with_its_own_speeds(tmp_path):
    found = run_parameters(simulation(tmp_path, "fixedwing", "aerosonde-2025"), 50.0)
    assert found["MIS_TAKEOFF_ALT"] == 50.0
    assert found["FW_AIRSPD_TRIM"] == 25
    assert "CA_ROTOR_COUNT" not in found


@pytest.mark.parametrize(("bias_pa", "offset"), [(35.0, 35.0), (0.0, 1e-3)])
def test_a_planes_pitot_tube_is_calibrated_before_the_flight(tmp_path, bias_pa, offset):
    file = tmp_path / "scenario.yaml"
    file.write_text(
        "name: it\nvehicle: {kind: fixedwing, parameters: aerosonde-2025}\n"
        f"sensors: {{imu: {{}}, airspeed: {{noise: {{bias: {bias_pa}}}}}}}"
    )
    found = run_parameters(Simulation(read_scenario(str(file))), 50.0)
    assert found["SENS_DPRES_OFF"] == pytest.approx(offset)


def test_a_planes_trim_throttle_holds_its_trim_airspeed(tmp_path):
    flight = simulation(tmp_path, "fixedwing", "aerosonde-2025")
    values = run_parameters(flight, 50.0)
    trim = flight.vehicle.trim(values["FW_AIRSPD_TRIM"], 1.225, 9.80665)
    assert values["FW_THR_TRIM"] == pytest.approx(trim.throttle)
    assert 0.7 < trim.throttle < 0.9  # measured in level flight under PX4: 0.78

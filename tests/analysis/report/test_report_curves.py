"""Derived curves: spectra, innovations with gates, balance of motors, instances."""

import numpy as np
import pytest

from analysis.field_maps.field_map import DATAFLASH, ULOG
from analysis.report.curves.derived_curves import derive_curves
from analysis.report.curves.recording import FlightData, Message, Signal
from analysis.report.curves.spectra import frequency_marks, spectrum_panels
from analysis.report.recordings.mapped_message import add_message

T_S = np.arange(0, 20, 0.004)


def turning(frequency_hz: float, amplitude: float = 1.0) -> FlightData:
    wave = amplitude * np.sin(2 * np.pi * frequency_hz * T_S)
    return FlightData("r", signals=[Signal("gyro", "x", T_S, wave)])


def test_a_spectrum_has_its_peak_where_the_signal_turns_and_holds_its_power() -> None:
    (panel,) = spectrum_panels(turning(60.0, 2.0))
    (spectrum,) = panel.spectra
    step_hz = spectrum.frequency_hz[1] - spectrum.frequency_hz[0]
    assert spectrum.frequency_hz[np.argmax(spectrum.density)] == pytest.approx(60, abs=step_hz)
    assert spectrum.density.sum() * step_hz == pytest.approx(2.0**2 / 2, rel=0.02)


def test_a_spectrogram_shows_when_the_frequency_changed() -> None:
    early = np.sin(2 * np.pi * 20 * T_S)
    late = np.sin(2 * np.pi * 80 * T_S)
    both = Signal("gyro", "x", T_S, np.where(T_S < 10, early, late))
    (panel,) = spectrum_panels(FlightData("r", signals=[both]))
    (image,) = panel.images
    rows, columns = image.level_db.shape
    loudest_hz = (np.argmax(image.level_db, axis=0) + 1) / rows * image.highest_hz
    at_s = image.start + (np.arange(columns) + 0.5) / columns * (image.end - image.start)
    assert loudest_hz[at_s < 9] == pytest.approx(20, abs=2)
    assert loudest_hz[at_s > 11] == pytest.approx(80, abs=2)


def test_the_sum_of_the_motors_has_a_spectrogram() -> None:
    hum = np.sin(2 * np.pi * 40 * T_S)
    motors = [Signal("actuators", f"motor {i}", T_S, 0.5 + 0.1 * i * hum) for i in (1, 2, 3, 4)]
    (panel,) = spectrum_panels(FlightData("r", signals=motors))
    (image,) = panel.images
    loudest_hz = (np.argmax(image.level_db, axis=0) + 1) / len(image.level_db) * image.highest_hz
    assert loudest_hz == pytest.approx(40, abs=2)


def test_slow_uneven_and_constant_signals_have_no_spectrum() -> None:
    rng = np.random.default_rng(1)
    slow = Signal("gyro", "x", np.arange(1000) * 0.2, rng.normal(size=1000))
    uneven = Signal("accel", "x", np.sort(rng.uniform(0, 20, 5000)), rng.normal(size=5000))
    constant = Signal("torque", "roll", T_S, np.ones(len(T_S)))
    assert spectrum_panels(FlightData("r", signals=[slow, uneven, constant])) == []


def test_filters_and_motors_are_marked_and_a_notch_that_is_off_is_not() -> None:
    speed = Signal("rpm", "motor 1", T_S, np.full(len(T_S), 6000.0))
    parameters = {
        "IMU_GYRO_CUTOFF": [(0.0, 40.0)],
        "INS_HNTCH_FREQ": [(0.0, 80.0)],
        "INS_HNTCH_ENABLE": [(0.0, 0.0)],
    }
    found = dict(
        (text, hz)
        for hz, text in frequency_marks(FlightData("r", signals=[speed], parameters=parameters))
    )
    assert found == {"gyro low-pass": 40.0, "motors": 100.0, "motors × 2": 200.0}


def test_an_innovation_comes_with_the_gate_of_its_parameter_both_ways() -> None:
    flight, t_s = FlightData("r"), np.array([0.0, 1.0])
    for name, values in (
        ("estimator_innovations", [0.5, -0.5]),
        ("estimator_innovation_variances", [0.04, 0.09]),
    ):
        message = Message(t_s, {"baro_vpos": np.array(values)})
        add_message(flight, ULOG[name], message, constants={"EKF2_BARO_GATE": 3.0})
    found = {s.name: s for s in flight.signals}
    assert found["gate baro"].value == pytest.approx([0.6, 0.9])
    assert found["gate baro, below"].value == pytest.approx([-0.6, -0.9])
    assert found["baro"].t_s == pytest.approx([0, 1])


def test_a_motor_with_a_higher_command_deviates_from_the_mean() -> None:
    motors = [
        Signal("actuators", f"motor {i + 1}", T_S, np.full(len(T_S), 0.5 + 0.2 * (i == 2)))
        for i in range(4)
    ]
    signals, _ = derive_curves(FlightData("r", signals=motors))
    middle = {s.name: s.value[len(T_S) // 2] for s in signals if s.panel == "balance"}
    assert middle["motor 3"] == pytest.approx(0.15)
    assert middle["motor 1"] == pytest.approx(-0.05)


def test_estimator_instances_with_different_tilt_diverge() -> None:
    signals = [
        Signal(f"instance-{part}", name, T_S, np.full(len(T_S), lean))
        for name, lean in (("instance", 0.0), ("instance 2", 3.0))
        for part in ("roll", "pitch")
    ]
    (apart,) = [
        s for s in derive_curves(FlightData("r", signals=signals))[0] if s.panel == "divergence"
    ]
    assert apart.name == "instance 2"
    assert apart.value == pytest.approx(np.hypot(3, 3), rel=1e-3)


def test_estimators_that_are_both_upside_down_agree() -> None:
    """One rolls through 180 degrees a little before the other."""
    t_s = np.arange(0.0, 10.0, 0.1)
    rolls = [(36.0 * t_s + lead + 180.0) % 360.0 - 180.0 for lead in (0.0, 2.0)]
    signals = [
        Signal(f"instance-{part}", f"instance {i + 1}", t_s, value)
        for i, roll in enumerate(rolls)
        for part, value in (("roll", roll), ("pitch", np.full(len(t_s), 10.0)))
    ]
    (apart,) = [
        s for s in derive_curves(FlightData("r", signals=signals))[0] if s.panel == "divergence"
    ]
    assert apart.value.max() == pytest.approx(2.0 * np.cos(np.radians(10.0)), abs=0.01)


def test_a_simulated_heading_of_ardupilot_is_in_degrees() -> None:
    message = Message(np.array([0.0, 1.0]), {"Yaw": np.array([350.0, 10.0])})
    data = FlightData("r")
    add_message(data, DATAFLASH["SIM"], message)
    (heading,) = (one for one in data.signals if one.panel == "yaw")
    assert heading.value == pytest.approx([-10.0, 10.0])

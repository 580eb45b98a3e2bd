import numpy as np
import pytest

from analysis.campaign.cell import Cell
from analysis.campaign.outcomes import OutcomeLimits, classify_flight
from analysis.flying.autopilot_evidence import (
    belongs_to_flight,
    text_marks,
    vehicle_marks,
)
from analysis.flying.flight_evidence import ATTITUDE, PATH, Evidence, EvidenceCurve
from analysis.scoring.vehicle_outcome import VehicleEvent
from mavproxy_fault.wire.tlog import row_dtype

T_US = np.arange(0, 20_000_000, 100_000)


def since(stamps_us):
    return stamps_us * 1e-6 - 2.0  # take-off after two seconds


def truth(height_m, tilt_deg=0.0, sink_mps=0.0):
    rows = np.zeros(len(T_US), row_dtype("HIL_STATE_QUATERNION"))
    rows["t_us"] = T_US
    rows["alt"] = 1000.0 * np.asarray(height_m)
    rows["vz"] = 100.0 * np.asarray(sink_mps)
    half = np.radians(tilt_deg) / 2.0
    rows["attitude_quaternion"][:, 0], rows["attitude_quaternion"][:, 1] = (
        np.cos(half),
        np.sin(half),
    )
    return rows


def flown_columns(down_at_s: float, sink_mps: float) -> dict[str, np.ndarray]:
    """A log of an ArduCopter that hovers at 10 m and comes down in LAND, without a command."""
    t_s = T_US * 1e-6
    height_m = np.clip((t_s - 2.0) * 5.0, 0.0, 10.0)
    height_m = np.minimum(height_m, np.clip(10.0 - (t_s - down_at_s) * sink_mps, 0.0, None))
    rows = truth(height_m, sink_mps=-np.gradient(height_m, t_s))
    rows["time_usec"], rows["system"], rows["lat"], rows["lon"] = T_US, 1, 474_000_000, 85_000_000
    beats = np.zeros(20, row_dtype("HEARTBEAT"))
    beats["t_us"], beats["system"], beats["component"] = np.arange(20) * 1_000_000, 1, 1
    beats["autopilot"], beats["type"] = 3, 2
    beats["custom_mode"] = np.where(np.arange(20) < down_at_s, 4, 9)
    beats["base_mode"] = np.where((np.arange(20) > 0) & (np.arange(20) < 18), 209, 81)
    command = np.zeros(1, row_dtype("COMMAND_LONG"))
    command["t_us"], command["system"], command["target_system"] = 500_000, 255, 1
    command["command"], command["param1"], command["param2"] = 176, 1, 4
    return {"HIL_STATE_QUATERNION": rows, "HEARTBEAT": beats, "COMMAND_LONG": command}


def test_the_end_of_the_vehicle_is_that_of_run_and_report() -> None:
    kinds = [mark.kind for mark in vehicle_marks(flown_columns(6.0, 1.0), 2_000_000)]
    assert kinds == ["failsafe"]
    hard = vehicle_marks(flown_columns(6.0, 8.0), 2_000_000)
    assert [mark.kind for mark in hard] == ["failsafe", "crashed"]
    assert [mark.t_s for mark in hard] == pytest.approx([4.0, 5.2], abs=0.1)


def test_warnings_and_changes_of_flags_are_marks() -> None:
    text = np.zeros(2, row_dtype("STATUSTEXT"))
    text["t_us"], text["severity"], text["component"] = [3_000_000, 4_000_000], [2, 6], 1
    text["text"] = [b"EKF variance", b"hello"]
    flags = np.zeros(3, row_dtype("EKF_STATUS_REPORT"))
    flags["t_us"], flags["flags"] = [1, 2_500_000, 3_500_000], [831, 831, 421]
    found = text_marks({"STATUSTEXT": text, "EKF_STATUS_REPORT": flags}, since)
    assert [(m.t_s, m.text) for m in found] == [
        (1.0, "EKF variance"), (1.5, "EKF_STATUS_REPORT flags 0x1a5"),
    ]  # fmt: skip


def test_a_vehicle_off_the_reference_path_is_degraded() -> None:
    def evidence_at(offset_m: float) -> Evidence:
        times = [float(t) for t in range(20)]
        path = {name: EvidenceCurve(times, [0.0] * 20) for name in PATH}
        path[PATH[1]] = EvidenceCurve(times, [offset_m if t > 8 else 0.0 for t in times])
        return Evidence({ATTITUDE: EvidenceCurve(times, [1.0] * 20), **path})

    cell = Cell(subject="copter", scenario="x", fault="f", onset=5.0, duration_s=5.0)
    result = classify_flight(cell, 5.0, evidence_at(12.0), evidence_at(0.0), OutcomeLimits())
    assert (result.outcome, result.excursion_m) == ("degraded", 12.0)


def test_after_the_command_to_land_only_a_bad_end_counts() -> None:
    landing_s = 40.0
    failsafe = VehicleEvent(20.0, "failsafe", "LAND")
    on_the_ground = [
        VehicleEvent(55.0, "failsafe", "LOITER"),
        VehicleEvent(54.0, "landed uncommanded", "not commanded"),
    ]
    crash = VehicleEvent(54.0, "crashed", "at 5.0 m/s")
    before_take_off = VehicleEvent(-3.0, "detected", "EKF_STATUS_REPORT flags 0x1a5")
    marks = [before_take_off, failsafe, *on_the_ground, crash]
    assert [mark for mark in marks if belongs_to_flight(mark, landing_s)] == [failsafe, crash]

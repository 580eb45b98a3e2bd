import numpy as np

from analysis.campaign.cell import ATTITUDE, PATH, Cell, Evidence, EvidenceCurve, FlightMark
from analysis.campaign.flying.autopilot_evidence import (
    belongs_to_flight,
    ground_marks,
    mode_marks,
    text_marks,
)
from analysis.campaign.outcomes import OutcomeLimits, classify_flight
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


def height(down_at_s: float) -> np.ndarray:
    t_s = T_US * 1e-6
    return np.where((t_s > 2.0) & (t_s < down_at_s), 10.0, 0.0)


def test_a_soft_touchdown_is_a_landing_and_a_hard_one_a_crash() -> None:
    (soft,) = ground_marks(truth(height(15.0), sink_mps=0.5), since, True)
    assert (soft.kind, soft.t_s) == ("landed", 13.0)
    (hard,) = ground_marks(truth(height(9.0), sink_mps=8.0), since, False)
    assert (hard.kind, hard.t_s) == ("crashed", 7.0)


def test_a_vehicle_upside_down_in_the_air_is_lost() -> None:
    tilt = np.where(T_US > 6_000_000, 120.0, 5.0)
    marks = ground_marks(truth(height(30.0), tilt_deg=tilt), since, False)
    assert [(mark.kind, round(mark.t_s, 1)) for mark in marks] == [("lost", 4.1)]


def test_changes_of_mode_and_warnings_are_marks() -> None:
    heartbeat = np.zeros(4, row_dtype("HEARTBEAT"))
    heartbeat["t_us"] = [0, 3_000_000, 4_000_000, 5_000_000]
    heartbeat["autopilot"], heartbeat["type"] = 3, 2
    heartbeat["custom_mode"] = [4, 4, 9, 9]
    heartbeat["autopilot"][1] = 8  # a ground station's
    assert [(m.kind, m.t_s, m.text) for m in mode_marks({"HEARTBEAT": heartbeat}, since)] == [
        ("failsafe", 2.0, "LAND")
    ]
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
    failsafe = FlightMark(20.0, "failsafe", "LAND")
    on_the_ground = [
        FlightMark(55.0, "failsafe", "LOITER"),
        FlightMark(54.0, "landed", "on the ground"),
    ]
    crash = FlightMark(54.0, "crashed", "at 5.0 m/s")
    before_take_off = FlightMark(-3.0, "detected", "EKF_STATUS_REPORT flags 0x1a5")
    marks = [before_take_off, failsafe, *on_the_ground, crash]
    assert [mark for mark in marks if belongs_to_flight(mark, landing_s)] == [failsafe, crash]

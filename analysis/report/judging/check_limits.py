"""Limits of the checks; each can be set in a criteria file (YAML, `--criteria`).

Sources: vibration, compass interference and board voltage from ArduPilot's log-analysis pages
("Diagnosing problems using Logs", "Measuring Vibration", "Compass interference"); EKF variance from
the default of FS_EKF_THRESH; PX4's vibration metric and the jamming indicator from PX4's pages on
Flight Review (jamming: about 40 is good, 80 is too much); the attitude limits lie around 30 deg,
where ArduPilot's crash check starts; innovation ratios from MAVLink's ESTIMATOR_STATUS (above 1 a
measurement is rejected). The others are chosen so that an uneventful flight passes.
"""

from typing import Any

import msgspec

from mavproxy_fault.documents.document_check import decode
from mavproxy_fault.documents.yaml_document import read_document


class Thresholds(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Pairs of limits: beyond the first is a warning, beyond the second a failure.

    A value counts once it has been beyond a limit for `hold_s`.
    """

    broken_bytes_percent: tuple[float, float] = (0.5, 10.0)
    frames_lost_percent: tuple[float, float] = (2.0, 20.0)
    silence_s: tuple[float, float] = (3.0, 15.0)
    vibration_ardupilot_mps2: tuple[float, float] = (30.0, 60.0)
    vibration_px4_mps2: tuple[float, float] = (4.905, 9.81)
    clipping_count: tuple[float, float] = (10.0, 100.0)
    # For fix, satellites, battery and voltages smaller is worse: the first limit is the larger.
    gps_fix_type: tuple[float, float] = (3.0, 2.0)
    gps_satellites: tuple[float, float] = (6.0, 4.0)
    gps_dilution: tuple[float, float] = (2.5, 5.0)
    gps_step_m: tuple[float, float] = (10.0, 30.0)
    gps_jamming: tuple[float, float] = (50.0, 80.0)
    innovation_ratio: tuple[float, float] = (0.5, 1.0)
    ekf_variance: tuple[float, float] = (0.5, 0.8)
    compass_change_percent: tuple[float, float] = (35.0, 60.0)
    battery_remaining_percent: tuple[float, float] = (20.0, 10.0)
    board_voltage_v: tuple[float, float] = (4.5, 4.3)
    attitude_control_deg: tuple[float, float] = (25.0, 45.0)
    attitude_error_deg: tuple[float, float] = (5.0, 15.0)
    position_error_m: tuple[float, float] = (10.0, 30.0)
    estimate_step_m: tuple[float, float] = (10.0, 30.0)
    height_error_m: tuple[float, float] = (5.0, 15.0)
    impact_mps: tuple[float, float] = (2.0, 3.0)
    motor_balance: tuple[float, float] = (0.15, 0.3)
    # A real quad's flights with intact propellers differ by up to 0.046 (benchmarks/verdicts.md).
    motor_change: tuple[float, float] = (0.05, 0.15)
    motor_limit_s: tuple[float, float] = (1.0, 3.0)
    gyro_apart_rps: tuple[float, float] = (0.05, 0.2)
    accel_apart_mps2: tuple[float, float] = (1.0, 3.0)
    estimators_apart_deg: tuple[float, float] = (5.0, 15.0)
    estimator_switches: tuple[float, float] = (3.0, 8.0)
    cell_v: tuple[float, float] = (3.4, 3.2)
    long_loops_percent: tuple[float, float] = (6.0, 10.0)  # as ArduPilot's LogAnalyzer
    hold_s: float = 1.0
    requirements: Any = None  # as in a scenario


def read_thresholds(path: str | None) -> Thresholds:
    """Read the thresholds of a file; the defaults if `path` is None.

    Raises
    ------
    ConfigError
        If the file is missing, not YAML, or has an unknown key.
    """
    if path is None:
        return Thresholds()
    document = read_document(path)
    # An empty file is valid and means all defaults.
    return decode(document._replace(data=document.data or {}), Thresholds)

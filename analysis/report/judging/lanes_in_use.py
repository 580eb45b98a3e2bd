"""Which of several estimators and IMUs flies the vehicle: it is judged, the others beside it.

ArduPilot's estimator core has the IMU of its place in EK3_IMU_MASK (or EK2's); PX4 logs the device
of each estimator instance.
"""

import re
from collections.abc import Mapping, Sequence

import msgspec
import numpy as np

from analysis.report.curves.recording import FlightData, Signal, Windows, inside_windows
from analysis.report.judging.checks import FAIL, WARN, CheckLimits, FlightCheck, check_level

IN_USE = "estimator in use"  # lane of the timeline
ALWAYS = ((-np.inf, np.inf),)
MASKS = ("EK3_IMU_MASK", "EK2_IMU_MASK")
MOST_IMUS = 8
NUMBER = re.compile(r" (\d+)$")


def number_of(name: str) -> int:
    """The number of an instance at the end of its name; the first one may have none."""
    found = NUMBER.search(name)
    return int(found[1]) if found else 1


def estimator_windows(recording: FlightData) -> Mapping[int, Windows]:
    """When each estimator was in use, by its number; the first one if the log does not say."""
    found: dict[int, list[tuple[float, float]]] = {}
    for span in recording.spans:
        if span.lane == IN_USE:
            found.setdefault(number_of(span.text), []).append((span.start_s, span.end_s))
    return found or {1: ALWAYS}


def imu_windows(recording: FlightData) -> Mapping[int, Windows]:
    """When the IMU of the estimator in use was which, by its number."""
    found: dict[int, Windows] = {}
    masks = [int(h[-1][1]) for name in MASKS if (h := recording.parameters.get(name))]
    listed = [i + 1 for i in range(MOST_IMUS) if masks and masks[0] >> i & 1]
    devices = _devices(recording, "vehicle_imu_status")
    numbers = {device: number for number, device in devices.items()}
    chosen = _devices(recording, "estimator_status")
    for core, windows in estimator_windows(recording).items():
        imu = listed[core - 1] if core <= len(listed) else core
        imu = numbers.get(chosen.get(core, 0), imu)
        found[imu] = (*found.get(imu, ()), *windows)
    return found


def _devices(recording: FlightData, name: str) -> dict[int, int]:
    """The accelerometer of each instance of a topic."""
    return {
        int(number or 1): int(message.columns["accel_device_id"][-1])
        for title, message in recording.messages.items()
        for word, _, number in [title.replace(f"{name}_", f"{name} ").partition(" ")]
        if word == name and number.isdigit() | (not number) and "accel_device_id" in message.columns
    }


def check_in_use(
    name: str,
    signals: Sequence[Signal],
    limits: CheckLimits,
    only: Windows | None,
    windows: Mapping[int, Windows],
) -> FlightCheck:
    """Check the curves of what is in use, by the numbers in their names; `windows` say when."""
    used, spare = [], []
    for signal in signals:
        inside = inside_windows(signal.t_s, windows.get(number_of(signal.name), ()))
        used.append(signal._replace(value=np.where(inside, signal.value, np.nan)))
        spare.append(signal._replace(value=np.where(inside, np.nan, signal.value)))
    # A single one is in use whatever its number.
    if len({number_of(signal.name) for signal in signals}) < 2:
        return check_level(name, signals, limits, only)
    found, other = (check_level(name, some, limits, only) for some in (used, spare))
    if other.verdict not in (WARN, FAIL):
        return found
    evidence = f"{found.evidence}; not in use: {other.evidence}"
    return msgspec.structs.replace(found, evidence=evidence)

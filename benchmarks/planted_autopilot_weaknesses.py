"""Does `search --violate` find weaknesses planted in autopilots? A table for docs/falsification.md.

python benchmarks/planted_autopilot_weaknesses.py px4=PROGRAM ardupilot=PROGRAM [NAME ...]

With `method=random` it flies random points in place of the default's even design.

Each weakness is a parameter file of an unmodified autopilot. A search of at most 100 flights stops
at the first violation; that flight is repeated three times with other noise, with the wrong
parameters and with the autopilot's own.
"""

import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import yaml

from analysis.flying.worker_pool import WorkerPool
from analysis.search.archive import Archive
from analysis.search.evaluation.evaluator import Evaluator
from analysis.search.search_command import search_cases
from analysis.search.space.point_scenario import faults_of
from analysis.search.space.test_file import TestFile, read_test

BUDGET, AGAIN = 100, 3
SCENARIO = {
    "name": "planted", "duration_s": 26, "vehicle": {"kind": "multirotor", "parameters": "iris"},
    "sensors": {"imu": [{"preset": "consumer-mems", "rate_hz": 250}] * 2,
                "mag": {"preset": "consumer-mag", "rate_hz": 50},
                "baro": {"preset": "consumer-baro", "rate_hz": 50},
                "gps": {"preset": "consumer", "rate_hz": 5}},
}  # fmt: skip
AT = {"at_s": [2, 12]}
SHORT = AT | {"for_s": [1, 4]}
# What an autopilot with its own parameters should withstand: short faults of one sensor of two, or
# of one that gates protect against, and the loss of GPS.
FAULTS = [
    {"fault": "bias", "any_of": ["HIL_GPS.lat", "HIL_GPS.lon"], "value": [-9000, 9000], **SHORT},
    {"fault": "drop", "target": "HIL_GPS", **AT, "for_s": [1, 15]},
    {"fault": "bias", "any_of": ["HIL_SENSOR.xgyro", "HIL_SENSOR.ygyro"], "value": [-0.2, 0.2],
     **SHORT, "also": {"where": {"id": 0}}},
    {"fault": "bias", "target": "HIL_SENSOR.abs_pressure", "value": [-3, 3], **SHORT},
    {"fault": "bias", "any_of": ["HIL_SENSOR.xmag", "HIL_SENSOR.ymag"], "value": [-0.1, 0.1],
     **SHORT},
]  # fmt: skip


# PX4's own failsafe acts 5.4 s after the loss, which counts as one after a second.
SOON = (
    "gps_lost and not landing -> eventually[0,7](not gps_lost or mode in [LAND, ALTCTL, DESCEND] "
    "or landed)"
)


class Weakness(NamedTuple):
    """Wrong parameters of an autopilot, and the requirement that they endanger."""

    kind: str
    parameters: str
    violate: str


WEAKNESSES = {
    "ArduCopter: gates of GPS wide open": Weakness(
        "ardupilot", "EK3_POS_I_GATE 30000\nEK3_VEL_I_GATE 30000\nEK3_GLITCH_RAD 100",
        "knows_its_place"),
    "ArduCopter: EKF failsafe off": Weakness("ardupilot", "FS_EKF_THRESH 0", "gps_failsafe"),
    "ArduCopter: one EKF lane": Weakness("ardupilot", "EK3_IMU_MASK 1", "controlled"),
    "PX4: gates of GPS wide open": Weakness(
        "px4", "EKF2_GPS_P_GATE 100\nEKF2_GPS_V_GATE 100", "knows_its_place"),
    "PX4: dead reckoning for 10 s": Weakness(
        "px4", "EKF2_NOAID_TOUT 10000000\nCOM_POS_FS_EPH -1", SOON),
    "PX4: one EKF, no vote among IMUs": Weakness(
        "px4", "EKF2_MULTI_IMU 0\nSENS_IMU_MODE 1\nSENS_IMU_AUTOCAL 0", "controlled"),
}  # fmt: skip


def write_search(folder: Path, weakness: Weakness, binary: str, method: str) -> TestFile:
    """The test with the wrong parameters."""
    (folder / "wrong.parm").write_text(weakness.parameters + "\n")
    (folder / "scenario.yaml").write_text(yaml.safe_dump(SCENARIO))
    choice = {"kind": weakness.kind, "binary": binary, "parameters": str(folder / "wrong.parm")}
    test = {
        "scenario": "scenario.yaml", "estimator": "autopilot", "autopilot": choice,
        "at_once": [1, 2],
        "violate": weakness.violate, "budget": BUDGET, "first": True, "keep": 1, "faults": FAULTS,
        "method": method,
    }  # fmt: skip
    (folder / "search.yaml").write_text(yaml.safe_dump(test))
    return read_test(folder / "search.yaml")


def violations(test: TestFile, values: dict[str, float], number: int) -> str:
    """In how many repeated flights with other noise the requirement is violated."""
    flown = [Evaluator(test).scores(values, 77, number + k) for k in range(AGAIN)]
    return f"{sum(bool(one.rmse_deg[0] > 0.0) for one in flown)} of {AGAIN}"


def measure(name: str, weakness: Weakness, binary: str, method: str) -> str:
    """The row of a weakness."""
    with tempfile.TemporaryDirectory(prefix="planted-") as scratch:
        folder = Path(scratch)
        test, archive = write_search(folder, weakness, binary, method), Archive(1)
        flown, _ = search_cases(test, WorkerPool(), folder / "found", archive, Counter(), None)
        case = archive.cases[0]
        if case.fitness <= 0.0:
            return " | ".join([name, weakness.violate, f"not in {flown}", "", "", ""])
        values = Evaluator(test).space.values_at(case.point)
        faults = "; ".join(describe(fault) for fault in faults_of(test, values))
        assert test.autopilot is not None
        own = msgspec.structs.replace(test.autopilot, parameters=None)
        healthy = msgspec.structs.replace(test, autopilot=own)
        row = [name, weakness.violate, str(case.number + 1), faults]
        row += [violations(one, values, case.number) for one in (test, healthy)]
        return " | ".join(row)


def describe(fault: dict[str, Any]) -> str:
    """A fault in some words."""
    value = f" {fault['value']:.3g}" if "value" in fault else ""
    return f"{fault['fault']} {fault['target']}{value} for {fault['for_s']:.1f} s"


def main(arguments: list[str]) -> None:
    """Print the table."""
    binaries = dict(one.split("=", 1) for one in arguments if "=" in one)
    names = [one for one in arguments if "=" not in one]
    method = binaries.pop("method", "mixed")
    print(
        "| weakness | requirement | flights | found | again | healthy |\n|---|---|---|---|---|---|"
    )
    for name, weakness in WEAKNESSES.items():
        if weakness.kind in binaries and (not names or any(part in name for part in names)):
            print(f"| {measure(name, weakness, binaries[weakness.kind], method)} |", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])

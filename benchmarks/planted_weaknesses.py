"""Does `search --violate` find planted weaknesses? Prints a table for docs/falsification.md.

python benchmarks/planted_weaknesses.py [NAME ...]

Each weakness is one wrong parameter of an estimator, or of the simulator's own controller. The
limit of the requirement is not chosen: it is 1.1 times the worst that a search of the same space
finds of the healthy subject in 100 flights. Then the search, with reduction, runs with at most 100
flights, and the reduced counterexample is flown again with the healthy subject. A weakness counts
as found only if the healthy subject meets the requirement there, and if the weak one meets it in
the flight without faults and wind: one that shows without a fault needs no search.
"""

import contextlib
import io
import json
import shlex
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from analysis import estimators
from analysis.estimators.complementary import Gains, Mahony
from analysis.estimators.ekf import Ekf, Tuning
from analysis.flying.worker_pool import WorkerPool
from analysis.search.archive import Archive
from analysis.search.history import RECORD
from analysis.search.search_command import search_cases
from analysis.search.space.test_file import read_test
from mavproxy_fault import cli
from simvehicle.guidance import multirotor_controller as controller

BUDGET, MARGIN = 100, 1.1
MISSION = [{"shape": "s", "size_m": 40, "height_m": 20, "speed_mps": 5, "laps": 3}]
QUAD = {
    "name": "quad", "duration_s": 6, "start": {"height_m": 20},
    "vehicle": {"kind": "multirotor", "parameters": "iris"},
    "sensors": {"imu": {"preset": "consumer-mems", "rate_hz": 100},
                "mag": {"preset": "consumer-mag", "rate_hz": 25},
                "gps": {"preset": "consumer", "rate_hz": 5}},
}  # fmt: skip
WHEN = {"at_s": [1, 3], "for_s": [1, 5]}
# Faults of one sensor, as large as consumer sensors have them.
SENSORS = [
    {
        "fault": "bias",
        "any_of": [f"HIL_SENSOR.{a}gyro" for a in "xyz"],
        "value": [-0.1, 0.1],
        **WHEN,
    },
    {
        "fault": "bias",
        "any_of": [f"HIL_SENSOR.{a}acc" for a in "xyz"],
        "value": [-1.0, 1.0],
        **WHEN,
    },
    {
        "fault": "bias",
        "any_of": [f"HIL_SENSOR.{a}mag" for a in "xy"],
        "value": [-0.05, 0.05],
        **WHEN,
    },
    {"fault": "bias", "any_of": ["HIL_GPS.vn", "HIL_GPS.ve"], "value": [-100, 100], **WHEN},
    {"fault": "drop", "target": "HIL_GPS", **WHEN},
    {"fault": "freeze", "target": "HIL_SENSOR.xmag", **WHEN},
]
PLANT = [
    {
        "fault": "plant",
        "any_of": ["PLANT.wind_n_mps", "PLANT.wind_e_mps"],
        "value": [-8, 8],
        **WHEN,
    },
    {"fault": "plant", "target": "PLANT.wind_d_mps", "value": [-2, 2], **WHEN},
]
WIND = {f"environment.wind_ned_mps[{i}]": [-4, 4] for i in (0, 1)}
ATTITUDE = ("attitude_error_deg", "always(attitude_error_deg < {})")
PLACE = ("distance_m", "always(distance_m < {})")
HEIGHT = ("height_m", "always(abs(height_m - 20) < {})")


class Weakness:
    """A wrong parameter of the estimator that `factory` makes, or `constants` of the controller."""

    def __init__(
        self,
        factory: Callable[[], Any] = Ekf,
        healthy: Callable[[], Any] = Ekf,
        requirement: tuple[str, str] = ATTITUDE,
        faults: list[dict[str, Any]] = SENSORS,
        scenario: dict[str, Any] | None = None,
        **constants: float,
    ) -> None:
        self.factory, self.healthy, self.constants = factory, healthy, constants
        self.requirement, self.faults, self.scenario = (
            requirement,
            faults,
            scenario or QUAD | {"mission": MISSION},
        )

    @contextlib.contextmanager
    def planted(self, wrong: bool) -> Iterator[None]:
        """The estimator `planted` and the controller, wrong or healthy."""
        right = {name: getattr(controller, name) for name in self.constants}
        sys.modules[__name__].make_planted = self.factory if wrong else self.healthy
        estimators.BUILT_IN["planted"] = f"{__name__}:make_planted"
        for name, value in self.constants.items():
            setattr(controller, name, value if wrong else right[name])
        try:
            yield
        finally:
            for name, value in right.items():
                setattr(controller, name, value)


def ekf(start_sigma: tuple[float, float, float] = Ekf().start_sigma, **wrong: float) -> Weakness:
    return Weakness(lambda: Ekf(Tuning(**wrong), start_sigma))


def mahony(**wrong: float) -> Weakness:
    return Weakness(lambda: Mahony(Gains(**wrong)), Mahony)


def hover(requirement: tuple[str, str], **constants: float) -> Weakness:
    return Weakness(requirement=requirement, faults=PLANT, scenario=QUAD, **constants)


WEAKNESSES = {
    "EKF: GPS timeout 1e6 s": ekf(gps_timeout_s=1e6),
    "EKF: GPS timeout 0.3 s": ekf(gps_timeout_s=0.3, gravity_variance=0.02**2),
    "EKF: trusts GPS velocity (0.01 m/s)": ekf(velocity_variance=0.01**2),
    "EKF: ignores GPS velocity (50 m/s)": ekf(velocity_variance=50.0**2),
    "EKF: trusts the compass (0.001 rad)": ekf(heading_variance=0.001**2),
    "EKF: ignores the compass (10 rad)": ekf(heading_variance=10.0**2),
    "EKF: learns no gyro bias": ekf(bias_density=1e-9, start_sigma=(0.05, 1e-6, 0.5)),
    "EKF: gyro bias wanders (0.05)": ekf(bias_density=0.05),
    "EKF: trusts the gyro (1e-6)": ekf(gyro_density=1e-6),
    "EKF: trusts the accelerometer (1e-4)": ekf(accel_density=1e-4, velocity_variance=0.02**2),
    "Mahony: no tilt gain": mahony(tilt=0.0),
    "Mahony: tilt gain 4": mahony(tilt=4.0),
    "Mahony: no heading gain": mahony(heading=0.0),
    "Mahony: heading gain 20": mahony(heading=20.0),
    "Mahony: bias gain 0.5": mahony(bias=0.5),
    "Mahony: no bias gain": mahony(bias=0.0),
    "controller: no integral": hover(PLACE, _INTEGRAL_GAIN=0.0),
    "controller: tilt limit 9 degrees": hover(PLACE, _HORIZONTAL_ACCEL_MPS2=1.5),
    "controller: speed gain a third": hover(PLACE, _SPEED_GAIN=0.8),
    "controller: height gain a fifth": hover(HEIGHT, _HEIGHT_GAIN=0.24),
}  # fmt: skip


def write_search(folder: Path, weakness: Weakness, limit: float, budget: int) -> Path:
    (folder / "quad.yaml").write_text(yaml.safe_dump(weakness.scenario))
    required = weakness.requirement[1].format(f"{limit:.4g}")
    test = {
        "scenario": "quad.yaml", "estimator": "planted", "violate": required, "at_once": [1, 2],
        "vary": WIND, "budget": budget, "keep": 1, "faults": weakness.faults, "rescore_draws": 5,
    }  # fmt: skip
    (folder / "search.yaml").write_text(yaml.safe_dump(test))
    return folder / "search.yaml"


def first_violation(folder: Path) -> int | None:
    """The number of flights up to the first violation, from the search's history."""
    fitness = np.frombuffer((folder / "history.bin").read_bytes(), RECORD)["fitness"]
    return int(np.argmax(fitness > 0.0)) + 1 if (fitness > 0.0).any() else None


def healthy_worst(folder: Path, weakness: Weakness) -> float:
    """The worst value of the required signal that a search finds of the healthy subject."""
    test = read_test(write_search(folder, weakness, 1e-3, BUDGET))
    archive = Archive(1)
    with weakness.planted(wrong=False):
        search_cases(test, WorkerPool(), folder / "healthy", archive, Counter(), None)
    return archive.cases[0].fitness + 1e-3


def fly_again(words: list[str], out: Path) -> str:
    """Whether a flight of `run` meets its requirement."""
    with contextlib.redirect_stdout(io.StringIO()):
        code = cli.main([*words, "--out", str(out), "--zenoh", "off", "--no-report"])
    assert code in (0, 1)
    judged = json.loads((out / "summary.json").read_text())["requirements"]
    return "met" if judged[0]["met"] else "violated"


def measure(name: str, weakness: Weakness, limits: dict[str, float]) -> str:
    """The row of a weakness."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        key = f"{weakness.healthy} {weakness.requirement}"
        if key not in limits:
            limits[key] = MARGIN * healthy_worst(folder, weakness)
        file = str(write_search(folder, weakness, limits[key], BUDGET))
        required = weakness.requirement[1].format(f"{limits[key]:.4g}")
        row = [name, f"{weakness.requirement[0]} < {limits[key]:.3g}"]
        calm = ["run", str(folder / "quad.yaml"), "--estimators", "planted", "--require", required]
        with weakness.planted(wrong=True):
            row.append(fly_again(calm, folder / "calm"))
            with contextlib.redirect_stdout(io.StringIO()):
                cli.main(["search", file, "--first", "--out", str(folder / "found")])
        row.append(str(first_violation(folder / "found") or "not found"))
        summary = json.loads((folder / "found" / "search-summary.json").read_text())
        if not summary["counterexamples"]:
            return " | ".join([*row, "", "", ""])
        found = summary["counterexamples"][0]
        kinds = "; ".join(f"{one['fault']} {one['target']}" for one in found["faults"]) or "none"
        with weakness.planted(wrong=False):
            healthy = fly_again(shlex.split(found["command"])[1:], folder / "again")
        return " | ".join([*row, kinds, f"{found['failed']} of {found['flown']}", healthy])


def main(names: list[str]) -> None:
    limits: dict[str, float] = {}
    print("| weakness | requirement | no fault | search | counterexample | again | healthy |")
    print("|---|---|---|---|---|---|---|")
    for name, weakness in WEAKNESSES.items():
        if not names or any(part in name for part in names):
            print(f"| {measure(name, weakness, limits)} |", flush=True)


if __name__ == "__main__":
    sys.modules["planted_weaknesses"] = sys.modules[__name__]
    main(sys.argv[1:])

"""The worst cases of a search as files: a log for people, and tests that fly each case again."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
import yaml

from analysis.search.batch import Batch, Outcome, ned_velocity
from analysis.search.shrink import pinned
from analysis.search.testfile import TestFile


class WorstCase(NamedTuple):
    """One of the worst cases.

    `searched_deg` is what the search saw, `error_deg` the mean over fresh noise with its standard
    error `sigma_deg`, `quiet_deg` the error without any noise: the share of the estimator's own
    integration and of the faults. `shrunk` are the values of the smallest fault, if there are any.
    """

    number: int
    values: dict[str, float]
    searched_deg: float
    error_deg: float
    sigma_deg: float
    quiet_deg: float
    rmse_deg: tuple[float, float, float, float]
    shrunk: dict[str, float] | None = None
    shrunk_deg: float | None = None


class Totals(NamedTuple):
    """What a search did; `rejected` counts flights that left the envelope, by the limit broken."""

    tests: int
    rejected: dict[str, int]
    steps: int
    wall_s: float
    sim_s: float


def write_cases(folder: Path, test: TestFile, cases: Sequence[WorstCase]) -> list[Path]:
    """`worst-01.yaml` and so on, and `worst-01-shrunk.yaml` where a smaller fault does it too."""
    paths = []
    for rank, case in enumerate(cases, 1):
        for suffix, values in (("", case.values), ("-shrunk", case.shrunk)):
            if values is not None:
                path = folder / f"worst-{rank:02}{suffix}.yaml"
                path.write_text(yaml_of(pinned(test, values)))
                paths.append(path)
    return paths


def yaml_of(test: TestFile) -> str:
    """A test file that reads back as `test`."""
    plain = msgspec.to_builtins(test)
    for fault in plain["faults"]:
        del fault["any_of"]
    return yaml.safe_dump(plain, sort_keys=False)


def log_text(test: TestFile, cases: Sequence[WorstCase], totals: Totals) -> str:
    """`TestResFile.log`: number of tests, greatest error, what led to it, run time."""
    rejected = sum(totals.rejected.values())
    lines = [
        f"Estimator under test      {test.estimator}",
        f"Vehicle                   {test.vehicle}",
        f"Number of tests           {totals.tests}",
        f"  outside the envelope    {rejected}"
        + "".join(f", {name} {count}" for name, count in sorted(totals.rejected.items())),
        f"Simulated time            {totals.sim_s:.0f} s",
        f"Run time                  {totals.wall_s:.1f} s",
    ]
    if not cases:
        return "\n".join([*lines, "No flight stayed within the envelope.", ""])
    worst = cases[0]
    names = ("roll", "pitch", "yaw")
    rmse = ", ".join(f"{n} {v:.4g}" for n, v in zip(names, worst.rmse_deg[:3], strict=True))
    lines += [
        f"Greatest error            {worst.error_deg:.4g} deg (RMSE, mean of "
        f"{test.rescore_draws} fresh noise draws, standard error {worst.sigma_deg:.2g})",
        f"  by axis                 {rmse} deg",
        f"  seen by the search      {worst.searched_deg:.4g} deg",
        f"  without noise           {worst.quiet_deg:.4g} deg",
        "",
        *state_lines(test, worst.values),
    ]
    if worst.shrunk is not None and worst.shrunk_deg is not None:
        lines += ["", f"Smallest fault found that still gives {worst.shrunk_deg:.4g} deg"]
        lines += fault_lines(test, worst.shrunk)
    lines += ["", "Worst cases, each in a file of its own", "  rank    test  error/deg"]
    lines += [f"  {i:4} {c.number:7}  {c.error_deg:9.4g}" for i, c in enumerate(cases, 1)]
    return "\n".join([*lines, ""])


def state_lines(test: TestFile, values: dict[str, float]) -> list[str]:
    """Initial position and velocities, controls, mission, wind, sensors and faults of a case."""
    height, rates = values["initial.height_m"], [values[f"initial.{n}_dps"] for n in "pqr"]
    body = [values[f"initial.{n}_mps"] for n in "uvw"]
    angles = [values[f"initial.{n}_deg"] for n in ("roll", "pitch", "yaw")]
    from simvehicle.rotation import quat_from_euler

    q = quat_from_euler(*np.radians(angles))
    ned = ned_velocity(q[:, None], np.array(body)[:, None])[:, 0]

    def row(label: str, numbers: Sequence[float], unit: str) -> str:
        return f"{label:26}" + " ".join(f"{x:10.4f}" for x in numbers) + f"  {unit}"

    lines = [
        row("Initial position", (0.0, 0.0, -height), "m, north east down"),
        row("Initial velocity", ned.tolist(), "m/s, north east down"),
        row("Initial body velocity", body, "m/s, u v w"),
        row("Initial attitude", angles, "deg, roll pitch yaw"),
        row("Initial rates", rates, "deg/s, p q r"),
    ]
    for section in ("controls", "mission", "wind", "sensors"):
        lines += [
            row(name, [value], "") for name, value in values.items() if name.startswith(section)
        ]
    return lines + fault_lines(test, values)


def fault_lines(test: TestFile, values: dict[str, float]) -> list[str]:
    """One line a fault."""
    return [
        f"Fault {i}: {f.fault} on {f.target}, value {f.value:.5g}, "
        f"at {f.at_s:.3f} s for {min(f.for_s, test.duration_s):.3f} s"
        for i, f in enumerate(pinned(test, values).faults)
    ]


def quiet(test: TestFile) -> TestFile:
    """The test without noise; biases stay."""
    names = [n for n in test.sensors.__struct_fields__ if "_sigma_" in n]
    sensors = msgspec.structs.replace(test.sensors, **dict.fromkeys(names, 0.0))
    return msgspec.structs.replace(test, sensors=sensors)


def quiet_outcome(test: TestFile, values: dict[str, float]) -> Outcome:
    """One case without noise."""
    batch = Batch(quiet(pinned(test, values)))
    return batch.evaluate(np.zeros((1, batch.space.dimension)), 0, 0, 1)

"""The worst cases of a search as files: a log, and scenarios that repeat the flights."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from analysis.search.evaluation.evaluator import Evaluator
from analysis.search.shrink import pin_values
from analysis.search.space.point_scenario import document_of, faults_of
from analysis.search.space.test_file import TestFile
from mavproxy_fault.documents.yaml_document import without_none, write_yaml
from mavproxy_fault.numerics.rotations.rotation import matrix_from_quat, quat_from_euler


class WorstCase(NamedTuple):
    """One of the worst cases.

    `searched_deg` is the fitness in the search, `error_deg` the mean over fresh noise with its
    standard error `sigma_deg`, `quiet_deg` the error without noise: that of integration and faults
    (None for flights in the simulator). `parts` are the scores of one flight with the simulator's
    seed `run_seed`. `shrunk` are the values with the smallest fault, if there
    is any.
    """

    number: int
    values: dict[str, float]
    searched_deg: float
    error_deg: float
    sigma_deg: float
    quiet_deg: float | None
    rmse_deg: tuple[float, float, float, float]
    run_seed: int
    parts: dict[str, Any]
    shrunk: dict[str, float] | None = None
    shrunk_deg: float | None = None


class Totals(NamedTuple):
    """Totals of a search; `rejected` counts flights that left the envelope, by the violated
    limit."""

    tests: int
    rejected: dict[str, int]
    steps: int
    wall_s: float
    sim_s: float


def write_cases(folder: Path, test: TestFile, cases: Sequence[WorstCase]) -> list[Path]:
    """Write each case as a scenario for `run`, a test for `search` and a test cell for `campaign`.

    `worst-01.yaml`, `worst-01-test.yaml`, `worst-01-campaign.yaml`, and with `-shrunk` after the
    number those with the smallest fault found.
    """
    paths = []
    for rank, case in enumerate(cases, 1):
        for suffix, values in (("", case.values), ("-shrunk", case.shrunk)):
            if values is None:
                continue
            name = f"worst-{rank:02}{suffix}"
            scenario = {**document_of(test, values, case.run_seed), "name": name}
            texts = {
                f"{name}.yaml": write_yaml(without_none(scenario)),
                f"{name}-test.yaml": yaml_of_test(pin_values(test, values)),
            }
            faults = faults_of(test, values)
            # A test cell of a campaign has one fault.
            if len(faults) == 1:
                cell = campaign_document(test, name, faults[0], case.run_seed)
                texts[f"{name}-campaign.yaml"] = write_yaml(cell)
            for file, text in texts.items():
                (folder / file).write_text(text)
                paths.append(folder / file)
    return paths


def campaign_document(
    test: TestFile, name: str, fault: dict[str, Any], seed: int
) -> dict[str, Any]:
    """A campaign file with the case as its only test cell; the scenario file is beside it."""
    known = ("id", "fault", "target", "value", "at_s", "for_s")
    entry = {key: fault[key] for key in ("id", "fault", "target")}
    if "value" in fault:
        entry["magnitudes"] = [fault["value"]]
    return {
        "name": name,
        "subjects": [test.estimator],
        "scenarios": [f"{name}.yaml"],
        "onsets": [fault["at_s"]],
        "durations_s": [fault.get("for_s", test.duration_s)],
        "seeds": [seed],
        "faults": [{**entry, "also": {k: v for k, v in fault.items() if k not in known}}],
    }


def yaml_of_test(test: TestFile) -> str:
    """The YAML text of a test file that reads back as `test`."""
    document = without_none(msgspec.to_builtins(test))
    # A drawn target is written as `target`; with its list it would be drawn again.
    for fault in document["faults"]:
        if "target" in fault:
            del fault["any_of"]
    return write_yaml(document)


def log_text(test: TestFile, cases: Sequence[WorstCase], totals: Totals) -> str:
    """`TestResFile.log`: number of tests, greatest error and its parameters, run time."""
    rejected = sum(totals.rejected.values())
    lines = [
        f"Estimator under test      {test.estimator}",
        f"Vehicle                   {vehicle_of(test)}",
        f"Number of tests           {totals.tests}",
        f"  outside the envelope    {rejected}"
        + "".join(f", {name} {count}" for name, count in sorted(totals.rejected.items())),
        f"Simulated time            {totals.sim_s:.0f} s",
        f"Run time                  {totals.wall_s:.1f} s",
    ]
    if not cases:
        # Every flight left the envelope: there is no worst case.
        return "\n".join([*lines, "No flight stayed within the envelope.", ""])
    worst = cases[0]
    names = ("roll", "pitch", "yaw")
    rmse = ", ".join(f"{n} {v:.4g}" for n, v in zip(names, worst.rmse_deg[:3], strict=True))
    unit = f" {test.unit}".rstrip()
    lines += [
        f"Greatest error            {worst.error_deg:.4g}{unit} (RMSE, mean of "
        f"{test.rescore_draws} fresh noise draws, standard error {worst.sigma_deg:.2g})",
        f"  by axis                 {rmse} deg",
        f"  in the search           {worst.searched_deg:.4g}{unit}",
    ]
    if worst.quiet_deg is not None:
        lines.append(f"  without noise           {worst.quiet_deg:.4g}{unit}")
    lines += [*part_lines(worst.parts), "", *state_lines(test, worst.values)]
    if worst.shrunk is not None and worst.shrunk_deg is not None:
        lines += ["", f"Smallest fault found that still gives {worst.shrunk_deg:.4g}{unit}"]
        lines += fault_lines(test, worst.shrunk) or ["none: so large an error needs no fault"]
    lines += ["", "Worst cases, each in a file of its own", "  rank    test  error" + unit]
    lines += [f"  {i:4} {c.number:7}  {c.error_deg:9.4g}" for i, c in enumerate(cases, 1)]
    return "\n".join([*lines, ""])


def vehicle_of(test: TestFile) -> str:
    """The vehicle: the scenario's, or the search's own."""
    if test.scenario is None:
        return test.vehicle
    assert isinstance(test.scenario, dict)
    vehicle = test.scenario.get("vehicle", {})
    return f"{vehicle.get('kind', '')} {vehicle.get('parameters', '')}".strip()


def part_lines(parts: Mapping[str, Any]) -> list[str]:
    """One flight of the worst case: percentiles, errors by phase and by fault, twelve states."""
    lines = []
    if "angle_percentiles_deg" in parts:
        shares = ", ".join(f"{p} % {v:.4g}" for p, v in parts["angle_percentiles_deg"].items())
        lines.append(f"  angle, percentiles      {shares} deg")
    for label, groups in (("phase", parts.get("phases", {})), ("fault", parts.get("faults", {}))):
        lines += [
            f"  {label} {name:17} {scores['rmse_deg']['max']:.4g} deg, angle "
            f"{scores['rmse_deg']['angle']:.4g} deg"
            for name, scores in groups.items()
            if scores["samples"]
        ]
    for key, label in (("state_rmse", "all twelve states"), ("inverted_rmse", "inverted sensors")):
        if key in parts:
            states = ", ".join(f"{name} {value:.3g}" for name, value in parts[key].items())
            lines.append(f"  {label:23} {states}")
    return lines


def state_lines(test: TestFile, values: dict[str, float]) -> list[str]:
    """Initial position and velocities, controls, mission, wind, sensors and faults of a case."""
    if test.scenario is not None:
        varied = [f"{k.removeprefix('vary.'):40} {v:.6g}" for k, v in values.items() if "vary" in k]
        return [*varied, *fault_lines(test, values)]
    height, rates = values["initial.height_m"], [values[f"initial.{n}_dps"] for n in "pqr"]
    body = [values[f"initial.{n}_mps"] for n in "uvw"]
    angles = [values[f"initial.{n}_deg"] for n in ("roll", "pitch", "yaw")]
    ned = matrix_from_quat(quat_from_euler(*np.radians(angles))) @ body

    def row(label: str, numbers: Sequence[float], unit: str) -> str:
        return f"{label:26}" + " ".join(f"{x:10.4f}" for x in numbers) + f"  {unit}"

    lines = [
        row("Initial position", (0.0, 0.0, -height), "m, north east down"),
        row("Initial velocity", ned.tolist(), "m/s, north east down"),
        row("Initial body velocity", body, "m/s, u v w"),
        row("Initial attitude", angles, "deg, roll pitch yaw"),
        row("Initial rates", rates, "deg/s, p q r"),
    ]
    usual, own = (msgspec.structs.asdict(sensors) for sensors in (TestFile().sensors, test.sensors))
    given = [f"sensors.{key}" for key in own if own[key] != usual[key]]
    # What is zero is not there, and sensors as usual need no line.
    lines += [
        row(name, [value], "").rstrip()
        for name, value in values.items()
        if (name.startswith(("controls", "mission", "wind")) and value) or name in given
    ]
    return lines + fault_lines(test, values)


def fault_lines(test: TestFile, values: Mapping[str, float]) -> list[str]:
    """One line per fault."""
    return [
        f"Fault {i}: {f['fault']} on {f['target']}, "
        + (f"value {f['value']:.5g}, " if "value" in f else "")
        + f"at {f['at_s']:.3f} s for {min(f.get('for_s', np.inf), test.duration_s):.3f} s"
        for i, f in enumerate(faults_of(test, values))
    ]


def without_noise(test: TestFile) -> TestFile:
    """The test without noise, with its biases."""
    # Noise has `_sigma_` in its name; biases are part of the case.
    names = [n for n in test.sensors.__struct_fields__ if "_sigma_" in n]
    sensors = msgspec.structs.replace(test.sensors, **dict.fromkeys(names, 0.0))
    return msgspec.structs.replace(test, sensors=sensors)


def noiseless_error(test: TestFile, values: Mapping[str, float]) -> float | None:
    """The error of one case without noise; None for flights in the simulator."""
    if test.simulated:
        return None
    batch = Evaluator(without_noise(pin_values(test, values)))
    # A test with fixed values has no dimension: one point, draw number 0.
    return float(batch.evaluate(np.zeros((1, batch.space.dimension)), 0, 0, 1).fitness[0])

"""Print the summary of a run to the terminal."""

import argparse
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import msgspec
from rich.table import Table
from rich.text import Text

from analysis.scoring.requirements import RequirementResult
from analysis.scoring.run_remarks import fault_remarks, run_remarks
from analysis.scoring.vehicle_outcome import VehicleOutcome, describe_vehicle
from mavproxy_fault.app.command_result import open_console, plain_table, print_result

# NO VERDICT is not a failure: there were no criteria, or the data were insufficient.
EXIT_CODES = {"PASS": 0, "NO VERDICT": 0, "FAIL": 1}
GOOD, BAD = ("PASS", "isolated"), ("FAIL", "wrong", "missed", "late")
COLOURS = dict.fromkeys(GOOD, "green") | dict.fromkeys(BAD, "red")


def show_summary(args: argparse.Namespace, summary: dict[str, Any], folder: Path | None) -> int:
    """Print the summary as text or JSON, and return the exit code of its verdict."""
    data = {**summary, "folder": folder}
    print_result(args, data, lambda: print_summary(summary, folder))
    return EXIT_CODES[summary["verdict"]]


def print_summary(summary: Mapping[str, Any], folder: Path | None) -> None:
    """Print the faults, the scores, the criteria that failed and where the files are."""
    console = open_console()

    def show(name: str, text: str, style: str | None = None) -> None:
        console.print(f"{name:<15} {text}", style=style, soft_wrap=True)

    if "outcome" in summary:
        found = msgspec.convert(summary["outcome"], VehicleOutcome)
        show("vehicle", describe_vehicle(found))
    if summary["faults"]:
        console.print(_faults(summary["faults"]))
        for row in summary["faults"]:
            for line in fault_remarks(row):
                show("", f"{row['id']}: {line}")
    for fault in summary.get("never_acted", ()):
        show("never acted", f"fault {fault} matched no message", "yellow")
    for line in summary.get("edited", ()):
        show("edited live", line, "yellow")
    attitude = summary["attitude_rmse_deg"]
    if attitude:
        axes = ", ".join(f"{axis} {attitude[axis]:.2f}" for axis in ("roll", "pitch", "yaw"))
        show("attitude RMSE", f"{axes} degrees")
    if summary["position_rmse_m"] is not None:
        show("position RMSE", f"{summary['position_rmse_m']:.2f} m")
    for name, text in _position_errors(summary):
        show(name, text)
    epochs = f"{summary['epochs']}, untestable {summary['untestable_epochs']}"
    false = _known(summary["false_alarms"])
    show("epochs", f"{epochs}, alarms {summary['alarms']}, false alarms {false}")
    show("monitored", ", ".join(summary["watched"]) or "nothing")
    for kind, text in run_remarks(summary):
        show(kind, text)
    for row in summary["false_by_channel"] or ():
        isolated = ", ".join(row["blamed"]) or "none"
        counts = f"{row['outside']} outside faults, {row['inside']} inside"
        text = (
            f"{row['channel']}: {counts}, {row['per_hour']:g} per hour; "
            f"wrongly isolated: {isolated}, for {row['seconds']:.1f} s"
        )
        show("false alarms", text)
    speed = summary["sim_s"] / summary["wall_s"] if summary["wall_s"] else 0.0
    took = f"{summary['sim_s']:.1f} s of flight in {summary['wall_s']:.1f} s"
    show("time", f"{took} (x{speed:.1f})")
    judged = msgspec.convert(summary.get("requirements", []), list[RequirementResult])
    for one in judged:
        style = {True: "green", False: "red", None: "yellow"}[one.met]
        show("requirement", f"{one.name}: {one.describe()}", style)
    names = {one.name for one in judged}
    for row in summary["criteria"]:
        if not row["passed"] and row["name"] not in names:
            # None: the data are insufficient.
            word = "FAILED" if row["passed"] is False else "NO VERDICT"
            show("criterion", f"{row['name']}: {row['value']} (limit {row['limit']}) {word}")
    for row in summary.get("effects", ()):
        show("effect", f"{row['id']}: {_effect(row)}")
    console.print("verdict        ", _coloured(summary["verdict"]))
    if folder is not None and (folder / "report.html").is_file():
        show("report", str(folder / "report.html"))


def _position_errors(summary: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Errors against the truth, and protection levels, as name and text."""
    for name, row in summary.get("position_error", {}).items():
        yield (
            f"error of {name:<6}",
            f"{row['horizontal_50_m']:.2f} m at 50 %, {row['horizontal_95_m']:.2f} m at 95 % "
            f"horizontal; {row['vertical_50_m']:.2f} m, {row['vertical_95_m']:.2f} m vertical; "
            f"error/sigma {row['over_sigma_50']}, {row['over_sigma_95']}",
        )
    for name, row in summary.get("integrity", {}).items():
        yield (
            "protection",
            f"{name} protection level {row['median_level_m']:.1f} m (median); error above it in "
            f"{row['misleading']} of {row['with_level']} epochs (largest error/level "
            f"{row['largest_error_over_level']:.2f}); level within the alert limit of "
            f"{row['alert_limit_m']:.0f} m in {100 * row['available_share']:.1f} % of epochs; "
            f"assumed: {' or '.join(row['assumes'])}",
        )


def _coloured(verdict: str) -> Text:
    return Text(verdict, COLOURS.get(verdict, "yellow"))


def _effect(row: Mapping[str, Any]) -> str:
    """Describe the effect of a fault on truth and estimate: largest and lasting change."""
    units = {"position_m": "m", "speed_mps": "m/s", "attitude_deg": "deg"}
    return ", ".join(
        f"{name} {extent['most']:.2f} {units[key]} at most, {extent['lasting']:.2f} lasting"
        for key in units
        for name, extent in row.get(key, {}).items()
    )


def _known(count: int | None) -> str:
    return "unknown without labels" if count is None else str(count)


def _faults(rows: list[Mapping[str, Any]]) -> Table:
    numbers = ("from s", "to s", "frames", "delay s")
    table = plain_table("fault", "target", *numbers, "isolated", "verdict", right=numbers)
    for row in rows:
        word = row["verdict"]
        first, *others = row["target"].split(", ")
        table.add_row(
            row["id"],
            f"{first} and {len(others)} more" if len(others) > 1 else row["target"],
            f"{row['start_s']:.1f}",
            "" if row["end_s"] is None else f"{row['end_s']:.1f}",
            str(row["frames"]),
            "" if row["delay_s"] is None else f"{row['delay_s']:.2f}",
            ", ".join(row["isolated"]),
            _coloured(word),
        )
    return table

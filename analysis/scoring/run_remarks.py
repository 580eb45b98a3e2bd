"""What a run could not test, could not explain or did not use: the words beside a verdict."""

from collections.abc import Mapping
from typing import Any

MANY_ALARMS_PER_HOUR = 20.0  # noise as assumed causes at most 1 at 1 Hz, and 8 at 10 Hz


def run_remarks(summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    """The remarks on a summary, each with its kind."""
    epochs = summary["epochs"]
    found = [
        ("untestable", f"{_epochs(count)}: {reason}")
        for reason, count in summary["untestable_reasons"].items()
    ]
    found += [
        ("unexplained", f"{count} of {_epochs(epochs)}: {reason}")
        for reason, count in summary.get("unexplained_reasons", {}).items()
    ]
    found += [("ephemeris", text) for text in summary.get("wrong_ephemerides", ())]
    unused: dict[str, list[str]] = {}
    for row in summary.get("unused_satellites", ()):
        named = unused.setdefault(row["reason"], [])
        named.append(f"{row['satellite']} in {_epochs(row['epochs'])}")
    found += [("not used", f"{reason}: {', '.join(named)}") for reason, named in unused.items()]
    if noise := summary.get("noise"):
        found.append(("noise", noise))
    return found + [("not observable", text) for text in _limits(summary)]


def fault_remarks(row: Mapping[str, Any]) -> list[str]:
    """The reason of a fault's verdict, and the false isolations during the fault."""
    wrongly = [
        f"{one['who']} isolated wrongly from {one['from_s']:.1f} s for {one['for_s']:.1f} s"
        for one in row.get("wrongly", ())
    ]
    return [row["reason"], *wrongly] if row.get("reason") else wrongly


def _epochs(count: int) -> str:
    return "1 epoch" if count == 1 else f"{count} epochs"


def _limits(summary: Mapping[str, Any]) -> list[str]:
    """The faults that the run could not observe."""
    found, epochs = [], summary["epochs"]
    if not {"gps-position", "satellites"} & set(summary["watched"]):
        found.append("position and velocity: no GNSS data")
    # Not the first seconds of a run with an IMU, in which its attitude is initialised.
    if 2 * summary["epochs_without_imu"] > epochs:
        found.append("coordinated spoofing of all satellites, as most epochs had no IMU")
        # Without labels, a plain antenna on the ground gives a hundred alarms per hour.
        if (
            summary["false_alarms"] is None
            and not summary.get("noise")
            and summary["alarms"] * 3600.0 > MANY_ALARMS_PER_HOUR * summary["sim_s"]
        ):
            found.append(
                "faulty satellites from a receiver noisier than assumed:"
                " fit the noise to a fault-free recording with --calibrate"
            )
    lost_s = summary.get("log", {}).get("lost_s", 0.0)
    if lost_s:
        found.append(f"dropouts during {lost_s:.1f} s in which the logger lost records")
    if summary["unbounded_epochs"]:
        found.append(f"{summary['unbounded_epochs']} of {epochs} positions: no protection level")
    return found

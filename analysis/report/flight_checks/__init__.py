"""The checks of a flight: each module has a function `run_checks` that returns a list of checks.

No check needs fault labels: GPS glitches, EKF variances, vibration, battery and compass problems
are found in any log with these data.
"""

import pkgutil
from functools import cache
from importlib import import_module
from typing import Any

from analysis.report.curves.recording import FlightData
from analysis.report.curves.vehicle_phase import armed_windows
from analysis.report.judging.check_limits import Thresholds
from analysis.report.judging.checks import FlightCheck


@cache
def _files() -> tuple[Any, ...]:
    """The modules of this package, in order of their names."""
    return tuple(
        import_module(f"{__name__}.{file.name}") for file in pkgutil.iter_modules(__path__)
    )


def flight_checks(recording: FlightData, thresholds: Thresholds) -> list[FlightCheck]:
    """Run all checks on one flight; those without data are "not judged"."""
    armed = armed_windows(recording)
    return [check for file in _files() for check in file.run_checks(recording, thresholds, armed)]

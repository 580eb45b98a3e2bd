"""What is checked in a flight: every file here is asked for its `checks`, a line each.

Nothing here needs labels: GPS glitches, EKF variance, vibration, battery and compass are found in
any log that carries them.
"""

import pkgutil
from functools import cache
from importlib import import_module
from typing import Any

from analysis.report.judging.check_limits import Thresholds
from analysis.report.judging.checks import FlightCheck, armed_windows
from analysis.report.recordings.recording import FlightData


@cache
def _files() -> tuple[Any, ...]:
    """The files of this folder, in the order of their names."""
    return tuple(
        import_module(f"{__name__}.{file.name}") for file in pkgutil.iter_modules(__path__)
    )


def flight_checks(recording: FlightData, thresholds: Thresholds) -> list[FlightCheck]:
    """Every check on one flight, judged or not."""
    armed = armed_windows(recording)
    return [check for file in _files() for check in file.checks(recording, thresholds, armed)]

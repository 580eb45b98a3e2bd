"""The checks of a flight: each module has a function `run_checks` that returns a list of checks.

No check needs fault labels: GPS glitches, EKF variances, vibration, battery and compass problems
are found in any log with these data. `SCOPES` says for which vehicles and which phase each holds.
"""

import pkgutil
from functools import cache
from importlib import import_module
from typing import Any, NamedTuple

import msgspec

from analysis.report.curves.recording import FlightData
from analysis.report.curves.vehicle_phase import (
    ARMED,
    COPTER,
    FLYERS,
    FLYING,
    ROVER,
    SUB,
    armed_windows,
)
from analysis.report.judging.check_limits import Thresholds
from analysis.report.judging.checks import NONE, FlightCheck


class CheckScope(NamedTuple):
    """Classes of vehicle and phase of the flight for which a check holds; no classes: all."""

    classes: frozenset[str]
    phase: str


_ALL: frozenset[str] = frozenset()
_FLYERS, _COPTER = frozenset(FLYERS), frozenset({COPTER})
_ON_LAND_OR_AIR = frozenset({*FLYERS, ROVER})
LOG, BENCH = "log", "before arming"
# By the name of the check, or its beginning.
SCOPES = {
    # A log and its links are judged in any phase, silences while armed.
    "log is complete": CheckScope(_ALL, LOG), "link from": CheckScope(_ALL, LOG),
    "flags of the autopilot": CheckScope(_ALL, ARMED),
    "estimator switches": CheckScope(_ALL, ARMED),
    "messages of the autopilot": CheckScope(_ALL, ARMED),
    "system status of the autopilot": CheckScope(_ALL, ARMED),
    "before arming": CheckScope(_ALL, BENCH),
    # The wheels shake a rover more than any limit for motors and propellers.
    "vibration": CheckScope(frozenset({*FLYERS, SUB}), ARMED),
    "accelerometer clipping": CheckScope(frozenset({*FLYERS, SUB}), ARMED),
    # On the ground a controller winds up against what holds the vehicle.
    "attitude control": CheckScope(_FLYERS, FLYING),
    "compass field strength": CheckScope(_ALL, ARMED),
    "battery remaining": CheckScope(_ALL, ARMED), "board voltage": CheckScope(_ALL, ARMED),
    "estimates are numbers": CheckScope(_ALL, ARMED),
    "innovation test ratios": CheckScope(_ALL, ARMED), "EKF variances": CheckScope(_ALL, ARMED),
    "estimate steps": CheckScope(_ON_LAND_OR_AIR, ARMED),
    "position against the truth": CheckScope(_ALL, ARMED),
    "height against the truth": CheckScope(_ALL, ARMED),
    "attitude against the truth": CheckScope(_ALL, ARMED),
    "ground impact": CheckScope(_FLYERS, ARMED), "vehicle ends upright": CheckScope(_FLYERS, ARMED),
    "log ends on the ground": CheckScope(_FLYERS, ARMED),
    # No signal of a satellite reaches a vehicle under water.
    "GPS fix": CheckScope(_ON_LAND_OR_AIR, ARMED),
    "GPS satellites": CheckScope(_ON_LAND_OR_AIR, ARMED),
    "GPS dilution of precision": CheckScope(_ON_LAND_OR_AIR, ARMED),
    "GPS jumps": CheckScope(_ON_LAND_OR_AIR, ARMED),
    "GPS jamming indicator": CheckScope(_ON_LAND_OR_AIR, LOG),
    # Lifting motors of equal share: neither a plane's, a helicopter's nor a submarine's.
    "motor balance": CheckScope(_COPTER, FLYING),
    "motors at their limit": CheckScope(_COPTER, FLYING),
    "gyroscopes agree": CheckScope(_ALL, ARMED), "accelerometers agree": CheckScope(_ALL, ARMED),
    "estimators agree": CheckScope(_ALL, ARMED), "cell voltage": CheckScope(_ALL, ARMED),
    "scheduler": CheckScope(_ALL, ARMED),
}  # fmt: skip


@cache
def _files() -> tuple[Any, ...]:
    """The modules of this package, in order of their names."""
    return tuple(
        import_module(f"{__name__}.{file.name}") for file in pkgutil.iter_modules(__path__)
    )


def flight_checks(recording: FlightData, thresholds: Thresholds) -> list[FlightCheck]:
    """Run all checks on one flight; those without data are "not judged"."""
    armed = armed_windows(recording)
    found = [check for file in _files() for check in file.run_checks(recording, thresholds, armed)]
    return [_within_scope(check, recording.vehicle) for check in found]


def _within_scope(check: FlightCheck, vehicle: str) -> FlightCheck:
    """The check, not judged for a class of vehicle for which it does not hold."""
    classes = scope_of(check.name).classes
    if not vehicle or not classes or vehicle in classes:
        return check
    evidence = f"does not hold for a {vehicle}"
    return msgspec.structs.replace(check, verdict=NONE, evidence=evidence, windows=())


def scope_of(name: str) -> CheckScope:
    """The scope of a check by its name."""
    return next(scope for word, scope in SCOPES.items() if name.startswith(word))

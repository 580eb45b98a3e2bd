"""Compares the compass with the World Magnetic Model at the first fix, without filter or attitude.

Detectors that know only a sensor's past accept a compass that was wrong from the start.
"""

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from analysis.detection.compass.earth_field_kernel import (
    ANGLE,
    SIZE,
    EarthField,
    new_earth_field,
    track_earth_field,
)
from analysis.detection.detector_registry import BlockDetector
from analysis.results import SensorDecision, pattern_alarm
from analysis.samples.block import FIX, FIX_3D, FIX_TYPE, Block
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.magnetic_field import date_of, magnetic_field_gauss

SAME_PLACE_DEG = 1.0  # the field changes by about 0.01 gauss within 1 degree
MOST_DEG = (90.0, 180.0)  # latitude and longitude on Earth
REASONS = {
    SIZE: "the field's size is {:+.2f} gauss off the World Magnetic Model",
    ANGLE: "the field's inclination is {:+.0f} degrees off the World Magnetic Model",
}


@dataclass(slots=True)
class EarthFieldState:
    """Where the model was evaluated, in degrees, and the state of the samples."""

    lat_deg: float = np.nan
    lon_deg: float = np.nan
    earth: EarthField = field(default_factory=new_earth_field)

    def is_near(self, places: Vector) -> NDArray[np.bool_]:
        """Which of some places (n, 2) in degrees have the model's field; none at first."""
        error: NDArray[np.bool_] = (
            np.abs(places - (self.lat_deg, self.lon_deg)).max(axis=1) < SAME_PLACE_DEG
        )
        return error


class EarthFieldDetector(BlockDetector, frozen=True):
    """Tests size and inclination of the field; a `field_ned_gauss` replaces the model's."""

    channels: ClassVar = frozenset({"mag"})

    field_ned_gauss: tuple[float, float, float] | None = None

    def new_state(self) -> EarthFieldState:
        """No place is known yet."""
        place = EarthFieldState()
        if self.field_ned_gauss is not None:
            _set_model(place, self.field_ned_gauss)
        return place

    def step(
        self, block: Block, state: EarthFieldState
    ) -> tuple[list[tuple[int, SensorDecision]], EarthFieldState]:
        """The alarms of the next samples by row, and the state, which is changed in place."""
        found: list[tuple[int, SensorDecision]] = []
        begin, end = 0, len(block.kind)
        while begin < end:
            end_of_part = (
                end if self.field_ned_gauss is not None else self._update_place(block, begin, state)
            )
            part = slice(begin, end_of_part)
            test, error = track_earth_field(
                block.kind[part], block.t_us[part], block.values[part], state.earth
            )
            found += [
                (begin + row, _result(int(block.t_us[begin + row]), int(test[row]), error[row]))
                for row in np.flatnonzero(test).tolist()
            ]
            begin = end_of_part
        return found, state

    def _update_place(self, block: Block, begin: int, state: EarthFieldState) -> int:
        """Evaluate the model if the first row is a fix at a new place; the next such fix's row."""
        rows = begin + np.flatnonzero(block.kind[begin:] == FIX)
        fixes = block.values[rows]
        on_earth = (fixes[:, FIX_TYPE] >= FIX_3D) & (np.abs(fixes[:, :2]) <= MOST_DEG).all(axis=1)
        rows, places = rows[on_earth], fixes[on_earth, :2]
        if len(rows) and rows[0] == begin and not state.is_near(places)[0]:
            state.lat_deg, state.lon_deg = places[0].tolist()
            day = date_of(int(block.t_us[begin]))
            _set_model(state, magnetic_field_gauss(state.lat_deg, state.lon_deg, 0.0, day))
        elsewhere = rows[~state.is_near(places)]
        return int(elsewhere[0]) if len(elsewhere) else len(block.kind)


def _set_model(place: EarthFieldState, field_ned_gauss: tuple[float, float, float]) -> None:
    north, east, down = field_ned_gauss
    level = np.hypot(north, east)
    place.earth.model[:] = np.hypot(level, down), np.arctan2(down, level)


def _result(t_us: int, test: int, error: float) -> SensorDecision:
    return pattern_alarm(
        t_us,
        "mag",
        REASONS[test].format(np.degrees(error) if test == ANGLE else error),
        suspect="imu-or-mag" if test == ANGLE else "",
        isolated=test == SIZE,
    )

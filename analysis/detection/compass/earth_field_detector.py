"""A compass that never had the Earth's field: a step of the pipeline without filter and attitude.

What a sensor has been like since the start is usual for whoever knows its own past only. The World
Magnetic Model tells what it ought to be like where the first fix is.
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
from analysis.samples.block import FIX, FIX_TYPE, Block
from analysis.samples.sample import Vector
from mavproxy_fault.numerics.magnetic_field import date_of, magnetic_field_gauss

FIX_3D = 3
SAME_PLACE_DEG = 1.0  # the field changes by some 0.01 gauss on the way
MOST_DEG = (90.0, 180.0)
REASONS = {
    SIZE: "the field's size is {:+.2f} gauss off the World Magnetic Model",
    ANGLE: "the field's inclination is {:+.0f} degrees off the World Magnetic Model",
}


@dataclass(slots=True)
class EarthFieldState:
    """Where the model was asked, in degrees, and what is kept of the samples."""

    lat_deg: float = np.nan
    lon_deg: float = np.nan
    earth: EarthField = field(default_factory=new_earth_field)

    def is_near(self, places: Vector) -> NDArray[np.bool_]:
        """Which of some places (n, 2) in degrees the model's answer is good for; none at first."""
        off: NDArray[np.bool_] = (
            np.abs(places - (self.lat_deg, self.lon_deg)).max(axis=1) < SAME_PLACE_DEG
        )
        return off


class EarthFieldDetector(BlockDetector, frozen=True):
    """A step of the pipeline; a `field_ned_gauss` takes the model's place."""

    channels: ClassVar = frozenset({"mag"})

    field_ned_gauss: tuple[float, float, float] | None = None

    def new_state(self) -> EarthFieldState:
        """Nothing came yet."""
        place = EarthFieldState()
        if self.field_ned_gauss is not None:
            _set_model(place, self.field_ned_gauss)
        return place

    def step(
        self, block: Block, state: EarthFieldState
    ) -> tuple[list[tuple[int, SensorDecision]], EarthFieldState]:
        """Whether the field is the Earth's, by the row that shows it, and the next state.

        The state is changed in place.
        """
        found: list[tuple[int, SensorDecision]] = []
        begin, end = 0, len(block.kind)
        while begin < end:
            until = (
                end if self.field_ned_gauss is not None else self._update_place(block, begin, state)
            )
            part = slice(begin, until)
            what, off = track_earth_field(
                block.kind[part], block.t_us[part], block.values[part], state.earth
            )
            found += [
                (begin + row, _result(int(block.t_us[begin + row]), int(what[row]), off[row]))
                for row in np.flatnonzero(what).tolist()
            ]
            begin = until
        return found, state

    def _update_place(self, block: Block, begin: int, state: EarthFieldState) -> int:
        """Ask the model where the first row is a fix far from the last such; the next one's row."""
        rows = begin + np.flatnonzero(block.kind[begin:] == FIX)
        fixes = block.values[rows]
        on_earth = (fixes[:, FIX_TYPE] >= FIX_3D) & (np.abs(fixes[:, :2]) <= MOST_DEG).all(axis=1)
        rows, places = rows[on_earth], fixes[on_earth, :2]
        if len(rows) and rows[0] == begin and not state.is_near(places)[0]:
            state.lat_deg, state.lon_deg = places[0].tolist()
            day = date_of(int(block.t_us[begin]))
            _set_model(state, magnetic_field_gauss(state.lat_deg, state.lon_deg, 0.0, day))
        far = rows[~state.is_near(places)]
        return int(far[0]) if len(far) else len(block.kind)


def _set_model(place: EarthFieldState, field_ned_gauss: tuple[float, float, float]) -> None:
    north, east, down = field_ned_gauss
    level = np.hypot(north, east)
    place.earth.model[:] = np.hypot(level, down), np.arctan2(down, level)


def _result(t_us: int, what: int, off: float) -> SensorDecision:
    return pattern_alarm(
        t_us,
        "mag",
        REASONS[what].format(np.degrees(off) if what == ANGLE else off),
        suspect="imu-or-mag" if what == ANGLE else "",
        isolated=what == SIZE,
    )

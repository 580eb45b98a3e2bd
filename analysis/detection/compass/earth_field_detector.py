"""Compares the compass with the World Magnetic Model at the first fix, without filter or attitude.

Detectors that know only a sensor's past accept a compass that was wrong from the start
(docs/watches.md, "The Earth's field").
"""

import math
from dataclasses import dataclass, field
from typing import ClassVar

from analysis.detection.compass.compass_samples import ZERO, Axis, add, compass_samples, dot
from analysis.detection.detector_registry import BlockDetector, RowResults
from analysis.results import SensorDecision, pattern_alarm
from analysis.samples.block import FIX, FIX_3D, FIX_TYPE, FORCE, MAG, Block
from mavproxy_fault.numerics.constants import STANDARD_GRAVITY_MPS2
from mavproxy_fault.numerics.magnetic_field import date_of, magnetic_field_gauss

SAME_PLACE_DEG = 1.0  # the field changes by about 0.01 gauss within 1 degree
MOST_DEG = (90.0, 180.0)  # latitude and longitude on Earth
# Defaults of PX4 1.18, which refuses a compass beyond them: EKF2_MAG_CHK_STR, EKF2_MAG_CHK_INC
MOST_GAUSS, MOST_RAD = 0.2, 0.349
# Windows in a row, and their length: passing a steel beam takes less. `magnetic-interference` of
# 10 s (benchmarks/preset_table.py) is found after 6 s, with windows of 2 s not at all.
CONFIRM_WINDOWS, WINDOW_US = 5, 1_000_000
LEAST_SAMPLES = 3  # of a mean: in fewer neither a turn nor a manoeuvre shows
FORCE_MPS2 = 0.5  # mean specific force less gravity: 5 %, or 3 degrees of a wrong vertical
STEADY_SHARE = 0.8  # size of the mean field over the mean size: the mean of a turn by 130 degrees


@dataclass(slots=True)
class _FieldWindow:
    """Sums of magnetic field, its magnitude and specific force over a second, and their counts."""

    number: int = 0
    field: Axis = ZERO
    size: float = 0.0
    fields: int = 0
    force: Axis = ZERO
    forces: int = 0

    def add(self, kind: int, values: tuple[float, ...]) -> None:
        """Add a sample of the compass or the IMU."""
        x, y, z = values[:3] if kind == MAG else values[FORCE : FORCE + 3]
        vector, size = (x, y, z), math.hypot(x, y, z)
        if not math.isfinite(size):
            return
        if kind == MAG:
            self.field, self.size = add(self.field, vector), self.size + size
            self.fields += 1
        else:
            self.force, self.forces = add(self.force, vector), self.forces + 1

    def inclination_rad(self) -> float:
        """The angle of the field below the horizon, NaN if that is unknown."""
        force = math.hypot(*self.force) / max(self.forces, 1)
        field = math.hypot(*self.field)
        if (
            self.forces < LEAST_SAMPLES
            or abs(force - STANDARD_GRAVITY_MPS2) > FORCE_MPS2
            or field < STEADY_SHARE * self.size
            or field == 0.0
        ):
            return math.nan
        # At rest the specific force points up.
        down = -dot(self.field, self.force) / (field * force * self.forces)
        return math.asin(min(1.0, max(-1.0, down)))


@dataclass(slots=True)
class EarthFieldState:
    """Where the model was evaluated, its field, and the window that is being filled."""

    place_deg: tuple[float, float] = (math.nan, math.nan)
    size_gauss: float = math.nan
    inclination_rad: float = math.nan
    window: _FieldWindow = field(default_factory=_FieldWindow)
    size_run: int = 0  # failed windows in a row
    angle_run: int = 0

    def set_model(self, field_ned_gauss: tuple[float, float, float]) -> None:
        """Compare with this field from now on."""
        north, east, down = field_ned_gauss
        self.size_gauss = math.hypot(north, east, down)
        self.inclination_rad = math.atan2(down, math.hypot(north, east))


class EarthFieldDetector(BlockDetector, frozen=True):
    """Tests size and inclination of the field; a `field_ned_gauss` replaces the model's."""

    channels: ClassVar = frozenset({"mag"})

    field_ned_gauss: tuple[float, float, float] | None = None

    def new_state(self) -> EarthFieldState:
        """No place is known yet."""
        state = EarthFieldState()
        if self.field_ned_gauss is not None:
            state.set_model(self.field_ned_gauss)
        return state

    def step(self, block: Block, state: EarthFieldState) -> tuple[RowResults, EarthFieldState]:
        """The alarms of the next samples by row, and the state, which is changed in place."""
        found = []
        for row, kind, t_us, values in compass_samples(block):
            if kind == FIX:
                if self.field_ned_gauss is None and values[FIX_TYPE] >= FIX_3D:
                    _move(t_us, values[0], values[1], state)
                continue
            number = t_us // WINDOW_US
            if number != state.window.number:
                if alarm := _test_window(t_us, state):
                    found.append((row, alarm))
                if abs(number - state.window.number) > CONFIRM_WINDOWS:
                    state.size_run = state.angle_run = 0
                state.window = _FieldWindow(number)
            state.window.add(kind, values)
        return found, state


def _move(t_us: int, lat_deg: float, lon_deg: float, state: EarthFieldState) -> None:
    """Evaluate the model at a new place on Earth."""
    moved_deg = max(abs(lat_deg - state.place_deg[0]), abs(lon_deg - state.place_deg[1]))
    on_earth = abs(lat_deg) <= MOST_DEG[0] and abs(lon_deg) <= MOST_DEG[1]
    if on_earth and not moved_deg < SAME_PLACE_DEG:
        state.place_deg = lat_deg, lon_deg
        state.set_model(magnetic_field_gauss(lat_deg, lon_deg, 0.0, date_of(t_us)))


def _test_window(t_us: int, state: EarthFieldState) -> SensorDecision | None:
    """Compare the mean field of a full window with the Earth's."""
    window = state.window
    if window.fields < LEAST_SAMPLES or math.isnan(state.size_gauss):
        return None
    size_error = window.size / window.fields - state.size_gauss
    state.size_run = state.size_run + 1 if abs(size_error) > MOST_GAUSS else 0
    angle_error = window.inclination_rad() - state.inclination_rad
    if not math.isnan(angle_error):  # without an angle the count stays
        state.angle_run = state.angle_run + 1 if abs(angle_error) > MOST_RAD else 0
    if state.size_run >= CONFIRM_WINDOWS:
        reason = f"the field's size is {size_error:+.2f} gauss off the World Magnetic Model"
        return pattern_alarm(t_us, "mag", reason)
    if state.angle_run >= CONFIRM_WINDOWS and not math.isnan(angle_error):
        off = f"the field's inclination is {math.degrees(angle_error):+.0f} degrees off"
        reason = f"{off} the World Magnetic Model"
        return pattern_alarm(t_us, "mag", reason, suspect="imu-or-mag", isolated=False)
    return None

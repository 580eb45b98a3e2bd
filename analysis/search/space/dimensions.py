"""The search space of a test file, and its points as flights for the kernel."""

from collections.abc import Mapping
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from analysis.search.lanes import rows
from analysis.search.space.fault_picks import pick_entries
from analysis.search.space.fault_range import CHANNELS, DROP_CHANNELS
from analysis.search.space.section import Range
from analysis.search.space.test_file import TestFile
from mavproxy_fault.numerics.rotations.rotation import quat_from_euler

Array = NDArray[np.float64]
SECTIONS = ("initial", "controls", "mission", "wind", "sensors")
MISSION_ON, MISSION_OFF_PERIOD = 1.0, 1.0


@dataclass(frozen=True)
class Space:
    """Names, lower and upper ends (d,) of the searched values; names and values of fixed ones.

    Names are paths in the test file, such as `initial.roll_deg` or `faults[0].value`. A fault with
    several targets has the dimension `faults[0].target`.
    """

    names: tuple[str, ...]
    low: Array
    high: Array
    fixed: dict[str, float]

    @property
    def dimension(self) -> int:
        """Number of searched values."""
        return len(self.names)

    def values(self, points: Array) -> dict[str, Array]:
        """All values by name, (n,) each, of points (n, d) in the unit cube."""
        # Clipped: some methods step outside the unit cube.
        span = self.low + np.clip(points, 0.0, 1.0) * (self.high - self.low)
        count = len(points)
        fixed = {name: np.full(count, value) for name, value in self.fixed.items()}
        return fixed | {name: span[:, i] for i, name in enumerate(self.names)}


def space_of(entries: Mapping[str, Range]) -> Space:
    """The space of fixed numbers and ranges by name."""
    names, low, high = [], [], []
    fixed: dict[str, float] = {}
    for name, value in entries.items():
        # An interval of zero length is a fixed number: searchers need a volume.
        if isinstance(value, tuple) and value[0] < value[1]:
            names.append(name)
            low.append(value[0])
            high.append(value[1])
        else:
            fixed[name] = float(value[0] if isinstance(value, tuple) else value)
    return Space(tuple(names), np.array(low), np.array(high), fixed)


def flight_entries(test: TestFile, trim: Mapping[str, float]) -> dict[str, Range]:
    """Start, controls, wind and sensors; open values are those of the trim."""
    entries = {}
    for section in SECTIONS:
        part = getattr(test, section)
        for key, value in msgspec.structs.asdict(part).items() if part is not None else ():
            name = f"{section}.{key}"
            # None means "as trimmed": only these keys have a value there.
            entries[name] = trim[name] if value is None else value
    return entries


def fault_entries(test: TestFile) -> dict[str, Range]:
    """Magnitude, onset and duration of each fault, and the number that selects its target."""
    if test.at_once is not None:
        return pick_entries(test)
    entries: dict[str, Range] = {}
    for i, fault in enumerate(test.faults):
        entries |= {f"faults[{i}].{key}": value for key, value in fault.ranges().items()}
        count = len(fault.targets)
        # The target is searched as a number: equal parts of an interval are the targets.
        entries[f"faults[{i}].target"] = (0.0, float(count)) if count > 1 else 0.0
        if len(fault.on) > 1:
            entries[f"faults[{i}].on"] = (0.0, float(len(fault.on)))
    return entries


def target_of(test: TestFile, fault: int, value: float) -> str:
    """The target of a searched number."""
    targets = test.faults[fault].targets
    # The upper end of the interval belongs to the last target.
    return targets[min(int(value), len(targets) - 1)]


def flights_of(test: TestFile, values: Mapping[str, Array], motor_rps: float) -> Array:
    """Columns (ROWS, n) for the kernel, estimates starting at the truth; the motors of a quadrotor
    turn at `motor_rps`."""
    count = len(values["initial.height_m"])
    columns = np.zeros((rows.ROWS, count))
    _start(columns, values)
    # The kernel takes surface deflections in radians.
    radians = {name: np.radians(values[f"controls.{name}_deg"]) for name in SURFACES}
    columns[rows.OPEN_LOOP : rows.OPEN_LOOP + 4] = [*radians.values(), values["controls.throttle"]]
    # The initial positions are the commanded ones.
    columns[rows.CONTROL : rows.CONTROL + 4] = columns[rows.OPEN_LOOP : rows.OPEN_LOOP + 4]
    # Not zero: lanes without a mission divide by the period too.
    columns[rows.MISSION + 2] = MISSION_OFF_PERIOD
    if test.mission is not None:
        columns[rows.MISSION : rows.MISSION + 5] = [
            np.full(count, MISSION_ON),
            np.radians(values["mission.roll_deg"]),
            values["mission.period_s"],
            np.radians(values["mission.pitch_deg"]),
            values["mission.airspeed_mps"],
        ]
    columns[rows.WIND : rows.WIND + 3] = [
        values[f"wind.{a}_mps"] for a in ("north", "east", "down")
    ]
    # The steady wind is kept apart: gusts are added to a copy.
    columns[rows.STEADY : rows.STEADY + 3] = columns[rows.WIND : rows.WIND + 3]
    _sensors(columns, values)
    for slot in range(rows.SLOTS):
        # No channel has this number: an unused slot has no effect.
        columns[rows.FAULTS + slot * rows.FAULT_ROWS + rows.CHANNEL] = -1.0
    for slot in range(len(test.faults)):
        _fault(columns, test, slot, values)
    columns[rows.MOTOR : rows.MOTOR + 4] = motor_rps
    columns[rows.ALIVE] = 1.0
    return columns


SURFACES = ("elevator", "aileron", "rudder")


def _start(columns: Array, values: Mapping[str, Array]) -> None:
    euler = np.radians([values[f"initial.{name}_deg"] for name in ("roll", "pitch", "yaw")])
    velocity = [values[f"initial.{name}_mps"] for name in ("u", "v", "w")]
    down = -values["initial.height_m"]
    columns[rows.STATE + 2] = columns[rows.START_DOWN] = down
    columns[rows.STATE + 3 : rows.STATE + 6] = velocity
    columns[rows.STATE + 6 : rows.STATE + 10] = quat_from_euler(*euler).T
    columns[rows.STATE + 10 : rows.STATE + 13] = np.radians(
        [values[f"initial.{name}_dps"] for name in ("p", "q", "r")]
    )
    # The estimate starts at the truth.
    columns[rows.ESTIMATE : rows.ESTIMATE + 3] = euler
    columns[rows.ESTIMATE + 3 : rows.ESTIMATE + 6] = velocity
    columns[rows.ESTIMATE + 8] = down
    columns[rows.QUATERNION : rows.QUATERNION + 4] = columns[rows.STATE + 6 : rows.STATE + 10]


def _sensors(columns: Array, values: Mapping[str, Array]) -> None:
    columns[rows.GYRO_SIGMA] = np.radians(values["sensors.gyro_sigma_dps"])
    columns[rows.ACCEL_SIGMA] = values["sensors.accel_sigma_mps2"]
    columns[rows.FIELD_SIGMA] = values["sensors.field_sigma_gauss"]
    columns[rows.VELOCITY_SIGMA] = values["sensors.velocity_sigma_mps"]
    columns[rows.PRESSURE_SIGMA] = values["sensors.pressure_sigma_pa"]
    for i, name in enumerate(("sigma_pa", "bias_pa", "drift_pa_per_k")):
        columns[rows.STATIC_SIGMA + i] = values[f"sensors.static_{name}"]
    columns[rows.PLACE_KICK : rows.PLACE_KICK + 2] = values["sensors.position_kick_m"]
    columns[rows.PLACE_KICK + 2] = values["sensors.height_kick_m"]
    for i, axis in enumerate("xyz"):
        columns[rows.GYRO_BIAS + i] = np.radians(values[f"sensors.gyro_bias_{axis}_dps"])
        columns[rows.ACCEL_BIAS + i] = values[f"sensors.accel_bias_{axis}_mps2"]


def _fault(columns: Array, test: TestFile, slot: int, values: Mapping[str, Array]) -> None:
    """Fill one slot: the proxy's fault of the same name on one channel."""
    base = rows.FAULTS + slot * rows.FAULT_ROWS
    name = f"faults[{slot}]"
    kind = test.faults[slot].fault
    # A drop acts on a message, other faults on a field.
    known = DROP_CHANNELS if kind == "drop" else CHANNELS
    places = [known[target_of(test, slot, value)] for value in values[f"{name}.target"]]
    channel, unit = np.array(places).T
    at_s = values[f"{name}.at_s"]
    zero = np.zeros_like(at_s)
    value = values.get(f"{name}.value", zero)
    columns[base + rows.CHANNEL] = channel
    columns[base + rows.START] = at_s
    # Without a duration it lasts until the end.
    columns[base + rows.END] = at_s + values.get(f"{name}.for_s", zero + np.inf)
    # Every kind is factor, offset, rate and noise of one formula: no branches in the lanes.
    columns[base + rows.FACTOR] = 0.0 if kind == "constant" else value if kind == "scale" else 1.0
    columns[base + rows.OFFSET] = value * unit if kind in ("bias", "constant") else 0.0
    if kind == "drop":
        columns[base + rows.OFFSET] = np.nan  # a sample that never came
    columns[base + rows.RATE] = value * unit if kind == "drift" else 0.0
    columns[base + rows.SPREAD] = value * unit if kind == "noise" else 0.0
    # The frozen value is taken at the onset; until then there is none.
    columns[base + rows.HOLD] = 1.0 if kind == "freeze" else 0.0
    columns[base + rows.FROZEN] = np.nan

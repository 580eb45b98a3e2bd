"""Test files: what a search varies, how far, and what counts (YAML).

Wherever a `Range` stands, a number is fixed and a list `[low, high]` is searched.
"""

from pathlib import Path
from typing import Literal

import msgspec

from mavproxy_fault.errors import ConfigError
from simvehicle.documents import decode, read_document

Range = float | tuple[float, float]

# message field -> measured channel (see `rows`) and SI units per unit of the field
CHANNELS: dict[str, tuple[int, float]] = {
    "HIL_SENSOR.xgyro": (0, 1.0),
    "HIL_SENSOR.ygyro": (1, 1.0),
    "HIL_SENSOR.zgyro": (2, 1.0),
    "HIL_SENSOR.xacc": (3, 1.0),
    "HIL_SENSOR.yacc": (4, 1.0),
    "HIL_SENSOR.zacc": (5, 1.0),
    "HIL_SENSOR.xmag": (6, 1.0),
    "HIL_SENSOR.ymag": (7, 1.0),
    "HIL_SENSOR.zmag": (8, 1.0),
    "HIL_GPS.vn": (9, 0.01),
    "HIL_GPS.ve": (10, 0.01),
    "HIL_GPS.vd": (11, 0.01),
    "HIL_SENSOR.diff_pressure": (12, 100.0),
}


class _Section(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of the sections: unknown keys are errors; ranges must have an order."""

    def __post_init__(self) -> None:
        for name in self.__struct_fields__:
            value = getattr(self, name)
            if isinstance(value, tuple) and len(value) == 2 and value[0] > value[1]:
                raise ValueError(f"{name} = {list(value)} has its ends reversed; [low, high]")


class Initial(_Section, frozen=True):
    """State at the start; None is that of trimmed flight at the vehicle's cruising speed."""

    height_m: Range = 500.0
    u_mps: Range | None = None
    v_mps: Range = 0.0
    w_mps: Range | None = None
    roll_deg: Range = 0.0
    pitch_deg: Range | None = None
    yaw_deg: Range = 0.0
    p_dps: Range = 0.0
    q_dps: Range = 0.0
    r_dps: Range = 0.0


class OpenLoop(_Section, frozen=True):
    """Constant controls; None is that of the trim."""

    elevator_deg: Range | None = None
    aileron_deg: Range = 0.0
    rudder_deg: Range = 0.0
    throttle: Range | None = None


class Mission(_Section, frozen=True):
    """Rolling from side to side while holding pitch and airspeed (None: the trim's)."""

    roll_deg: Range = 30.0
    period_s: Range = 20.0
    pitch_deg: Range | None = None
    airspeed_mps: Range | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        shortest = self.period_s[0] if isinstance(self.period_s, tuple) else self.period_s
        if shortest <= 0.0:
            raise ValueError(f"period_s = {shortest} is not positive; seconds above 0")


class Wind(_Section, frozen=True):
    """Where the steady wind blows to."""

    north_mps: Range = 0.0
    east_mps: Range = 0.0
    down_mps: Range = 0.0


class Sensors(_Section, frozen=True):
    """Noise of each sample, one sigma, and constant biases.

    Defaults: ADXRS450 and ADXL325 (Beard and McLain, Small Unmanned Aircraft, appendix H), GPS
    speed and differential pressure from there too.
    """

    gyro_sigma_dps: Range = 0.13
    accel_sigma_mps2: Range = 0.0245
    field_sigma_gauss: Range = 0.002
    velocity_sigma_mps: Range = 0.05
    pressure_sigma_pa: Range = 2.0
    gyro_bias_x_dps: Range = 0.0
    gyro_bias_y_dps: Range = 0.0
    gyro_bias_z_dps: Range = 0.0
    accel_bias_x_mps2: Range = 0.0
    accel_bias_y_mps2: Range = 0.0
    accel_bias_z_mps2: Range = 0.0


class FaultRange(_Section, frozen=True):
    """One fault as in a schedule; `any_of` searches over targets too. Units are the field's."""

    fault: Literal["bias", "drift", "scale", "constant", "freeze"]
    target: str | None = None
    any_of: list[str] = []
    value: Range = 0.0
    at_s: Range = 0.0
    for_s: Range = 1e9

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.target is None) == (not self.any_of):
            raise ValueError("exactly one of target and any_of is needed")
        for target in self.targets:
            if target not in CHANNELS:
                raise ValueError(f"target {target!r} is unknown; known: {', '.join(CHANNELS)}")

    @property
    def targets(self) -> list[str]:
        """The targets there are to choose from."""
        return [self.target] if self.target is not None else self.any_of


class Limits(_Section, frozen=True):
    """The flight envelope: a flight that leaves it does not count."""

    pitch_deg: float = 80.0
    alpha_deg: float = 25.0
    beta_deg: float = 25.0
    airspeed_mps: tuple[float, float] = (12.0, 70.0)
    rate_dps: float = 300.0
    load_g: float = 5.0
    height_m: float = 0.0


class TestFile(_Section, frozen=True):
    """A whole test file.

    `criterion` is what is to become large: the greatest of the RMSE of roll, pitch and yaw, or
    the RMSE of the angle between estimate and truth. `breaks_at_deg` is the size from which an
    estimator counts as broken; the worst cases are shrunk to the smallest fault that reaches it
    (None: half their own error). `noise_draws` flights with their own noise make an evaluation.
    """

    __test__ = False  # not for pytest to collect

    vehicle: str = "aerosonde-2012"
    estimator: str = "inverse-model"
    criterion: Literal["euler", "angle"] = "euler"
    breaks_at_deg: float | None = None
    duration_s: float = 60.0
    dt_s: float = 0.01
    seed: int = 1
    method: str = "mixed"
    budget: int | None = None
    time_s: float | None = None
    keep: int = 10
    noise_draws: int = 4
    rescore_draws: int = 100
    initial: Initial = Initial()
    controls: OpenLoop = OpenLoop()
    mission: Mission | None = None
    wind: Wind = Wind()
    sensors: Sensors = Sensors()
    faults: list[FaultRange] = []
    envelope: Limits = Limits()
    density_kgpm3: float = 1.225
    inclination_deg: float = 64.0
    declination_deg: float = 3.0
    field_gauss: float = 0.48

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("duration_s", "dt_s", "keep", "noise_draws", "rescore_draws"):
            if getattr(self, name) <= 0:
                raise ValueError(f"{name} = {getattr(self, name)} is not positive; above 0")
        if len(self.faults) > 4:
            raise ValueError(f"faults has {len(self.faults)} entries; at most 4 are possible")


def read_test(path: Path | str) -> TestFile:
    """Read a test file.

    Raises
    ------
    ConfigError
        If it cannot be read, or a key or value is wrong.
    """
    document, lines = read_document(Path(path))
    if not isinstance(document, dict):
        raise ConfigError(f"{path}: holds no keys; a test file is a YAML mapping")
    return decode(document, TestFile, lines)

"""Test files (YAML): what a search varies, how far, and the criterion.

In a `Range` a number is fixed and a list `[low, high]` is searched. A test flies either the
search's own aircraft in compiled flights, or a scenario through the proxy.
"""

from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np

from analysis.scoring.requirements import Requirement, parse_requirements
from analysis.search.space.airframe import has_rotors
from analysis.search.space.fault_range import FaultRange, Range, RangeSection
from mavproxy_fault.documents.document_check import decode
from mavproxy_fault.documents.document_kind import check_kind
from mavproxy_fault.documents.yaml_document import read_document
from mavproxy_fault.numerics.constants import SEA_LEVEL_DENSITY_KGPM3
from simvehicle.scenario.scenario_file import read_scenario

AUTOPILOT = "autopilot"
MOST_AT_ONCE = 3  # faults of a catalogue: more than three are no simple counterexample
SIMULATOR_ESTIMATORS = (AUTOPILOT, "fusion")  # estimators that need the simulator's frames
COMPILED_ESTIMATORS = ("inverse-model", "complementary", "mahony", "ekf")
# Through the proxy, or with an estimator in Python, a flight takes up to a second, in which fifty
# compiled ones are flown.
SLOW_DEFAULTS = {"budget": 200, "keep": 3, "rescore_draws": 5}
NO_ENVELOPE = {
    "pitch_deg": 90.0, "alpha_deg": 180.0, "beta_deg": 90.0, "airspeed_mps": [0.0, 1000.0],
    "rate_dps": 1e5, "load_g": 1e3, "height_m": -1e4,
}  # fmt: skip


class InitialState(RangeSection, frozen=True):
    """Initial state; None is the value of trimmed flight at the vehicle's cruising speed."""

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


class SearchControls(RangeSection, frozen=True):
    """Constant controls; None is the control of the trim."""

    elevator_deg: Range | None = None
    aileron_deg: Range = 0.0
    rudder_deg: Range = 0.0
    throttle: Range | None = None


class Mission(RangeSection, frozen=True):
    """Rolling from side to side while holding pitch and airspeed (None: the trim's)."""

    roll_deg: Range = 30.0
    period_s: Range = 20.0
    pitch_deg: Range | None = None
    airspeed_mps: Range | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        # The lower end of a range decides.
        shortest = self.period_s[0] if isinstance(self.period_s, tuple) else self.period_s
        if shortest <= 0.0:
            raise ValueError(f"period_s = {shortest} is not positive; use seconds > 0")


class SteadyWind(RangeSection, frozen=True):
    """Velocity of the steady wind, the direction it blows to."""

    north_mps: Range = 0.0
    east_mps: Range = 0.0
    down_mps: Range = 0.0


class SearchSensors(RangeSection, frozen=True):
    """Noise of each sample, one sigma, and constant biases.

    `static` is the absolute pressure, which also drifts with the temperature relative to 15
    degrees; the kicks drive the GPS position's Gauss-Markov error, north, east and up. Defaults:
    ADXRS450, ADXL325 and MPXAZ6115A (Beard and McLain, Small Unmanned Aircraft, appendix H), as are
    GPS speed and differential pressure.
    """

    gyro_sigma_dps: Range = 0.13
    accel_sigma_mps2: Range = 0.0245
    field_sigma_gauss: Range = 0.002
    velocity_sigma_mps: Range = 0.05
    pressure_sigma_pa: Range = 2.0
    static_sigma_pa: Range = 10.0
    static_bias_pa: Range = 0.0
    static_drift_pa_per_k: Range = 0.0
    position_kick_m: Range = 0.03
    height_kick_m: Range = 0.05
    gyro_bias_x_dps: Range = 0.0
    gyro_bias_y_dps: Range = 0.0
    gyro_bias_z_dps: Range = 0.0
    accel_bias_x_mps2: Range = 0.0
    accel_bias_y_mps2: Range = 0.0
    accel_bias_z_mps2: Range = 0.0


class FlightEnvelope(RangeSection, frozen=True):
    """The flight envelope: a flight that leaves it does not count."""

    pitch_deg: float = 80.0
    alpha_deg: float = 25.0
    beta_deg: float = 25.0
    airspeed_mps: tuple[float, float] = (12.0, 70.0)
    rate_dps: float = 300.0
    load_g: float = 5.0
    height_m: float = 0.0


class StateScales(RangeSection, frozen=True):
    """Scales that weight the errors of the twelve states."""

    position_m: float = 10.0
    velocity_mps: float = 1.0
    angle_deg: float = 1.0
    rate_dps: float = 1.0


class AutopilotChoice(RangeSection, frozen=True):
    """An autopilot that flies the scenario from take-off to landing, as `run --autopilot` does.

    `at_s` of the faults counts from take-off.
    """

    kind: Literal["ardupilot", "px4"]
    binary: str | None = None
    parameters: str | None = None

    def options(self) -> list[str]:
        """The options of `run` that start it."""
        found = ["--autopilot", self.kind]
        for option, value in (("--binary", self.binary), ("--parameters", self.parameters)):
            found += [option, value] if value is not None else []
        return found


class TestFile(RangeSection, frozen=True):
    """A complete test file.

    `criterion` is maximised: the greatest RMSE of roll, pitch and yaw, the RMSE of the angle
    between estimate and truth, that of all twelve states in `state_scales`, or that of height,
    airspeed or position from inverted pressure and GPS models. `breaks_at_deg` is the error from
    which an estimator counts as broken; the worst cases are shrunk to the smallest fault that
    reaches it (None: half their own error). An evaluation is the mean of `noise_draws` flights
    with different noise. `settle_s` at the start of a flight is not scored.

    With `violate`, the search looks for flights that violate this requirement, a formula or a name,
    and stops at the `first` or at the budget. With `at_once`, `faults` are a catalogue, of which as
    many act as it says, from least to most.

    With `scenario`, `vary` gives the intervals of its keys, and `initial`, `controls`, `mission`,
    `wind` and `sensors` are ignored.
    """

    __test__ = False  # keeps pytest from collecting it

    scenario: str | dict[str, Any] | None = None
    vary: dict[str, tuple[float, float]] = msgspec.field(default_factory=dict)
    vehicle: str = "aerosonde-2012"
    estimator: str = "inverse-model"
    autopilot: AutopilotChoice | None = None
    criterion: Literal["euler", "angle", "state", "height", "airspeed", "position"] = "euler"
    state_scales: StateScales = StateScales()
    breaks_at_deg: float | None = None
    violate: str | None = None
    first: bool = False
    at_once: tuple[int, int] | None = None
    duration_s: float = 60.0
    settle_s: float = 0.0
    dt_s: float = 0.01
    seed: int = 1
    method: str = "mixed"
    budget: int | None = None
    time_s: float | None = None
    keep: int = 10
    noise_draws: int = 1
    rescore_draws: int = 20
    initial: InitialState = InitialState()
    controls: SearchControls = SearchControls()
    mission: Mission | None = None
    wind: SteadyWind = SteadyWind()
    gusts: Literal["none", "light", "moderate", "light-600m", "moderate-600m"] = "none"
    sensors: SearchSensors = SearchSensors()
    faults: list[FaultRange] = msgspec.field(default_factory=list)
    envelope: FlightEnvelope = FlightEnvelope()
    density_kgpm3: float = SEA_LEVEL_DENSITY_KGPM3
    inclination_deg: float = 64.0
    declination_deg: float = 3.0
    field_gauss: float = 0.48
    position_k_per_s: float = 0.01

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("duration_s", "dt_s", "keep", "noise_draws", "rescore_draws"):
            if getattr(self, name) <= 0:
                raise ValueError(f"{name} = {getattr(self, name)} is not positive; use values > 0")
        # Either alone is a mistake.
        if (self.estimator == AUTOPILOT) != (self.autopilot is not None):
            raise ValueError("estimator: autopilot needs the section autopilot; give both or none")
        if self.autopilot is not None and not (self.scenario and self.violate):
            raise ValueError(
                "autopilot needs scenario and violate, such as violate: knows_its_attitude"
            )
        if self.vary and self.scenario is None:
            raise ValueError("vary is set without scenario; give scenario too")
        if (self.violate or self.at_once) and not self.simulated:
            raise ValueError("violate and at_once need flights in the simulator; give scenario too")
        if self.at_once and not 0 <= self.at_once[0] <= self.at_once[1] <= MOST_AT_ONCE:
            raise ValueError(
                f"at_once = {list(self.at_once)}; [least, most], {MOST_AT_ONCE} at most"
            )
        if self.violate:
            _ = self.requirement
        for name, (low, high) in self.vary.items():
            if low > high:
                raise ValueError(f"vary.{name} = {[low, high]} has its ends reversed; [low, high]")
        if not self.simulated:
            self._check_compiled()
        elif self.criterion not in ("euler", "angle"):
            raise ValueError(
                f"criterion: {self.criterion} needs estimator inverse-model without `scenario`; "
                "give euler or angle"
            )

    def _check_compiled(self) -> None:
        for fault in self.faults:
            fault.check_compiled()
        # Compiled flights are scored from the first sample.
        if self.settle_s > 0.0:
            raise ValueError("settle_s is for flights in the simulator; leave it out")
        self._check_airframe()
        if self.criterion not in ("euler", "angle") and self.estimator != "inverse-model":
            raise ValueError(
                f"criterion: {self.criterion} needs all twelve states; {self.estimator} estimates "
                "fewer"
            )

    def _check_airframe(self) -> None:
        if not has_rotors(self.vehicle):
            return
        # Zeros are allowed: a saved case has them.
        if any(msgspec.structs.asdict(self.controls).values()):
            raise ValueError("controls are for a fixed wing; give a quadrotor a mission")
        if self.mission is not None and self.mission.airspeed_mps:
            raise ValueError("mission.airspeed_mps: quadrotors have no airspeed; leave it out")
        # A quadrotor has no pitot tube.
        if self.criterion == "airspeed":
            raise ValueError("criterion: airspeed needs a pitot tube; a quadrotor has none")

    @property
    def requirement(self) -> Requirement:
        """The requirement to violate: the scenario's of that name, of the library, or a formula.

        Raises
        ------
        ValueError
            If it is none of these.
        """
        own = self.scenario.get("requirements") if isinstance(self.scenario, dict) else None
        named = {one.label: one for one in parse_requirements(own)}
        assert self.violate is not None
        return named.get(self.violate) or parse_requirements(self.violate)[0]

    @property
    def unit(self) -> str:
        """The criterion's unit; that of twelve states is scaled and has none."""
        if self.violate is not None:
            return self.requirement.unit
        units = {"state": "", "height": "m", "airspeed": "m/s", "position": "m"}
        return units.get(self.criterion, "deg")

    @property
    def field_ned_gauss(self) -> tuple[float, float, float]:
        """The magnetic field: down by the inclination, east of north by the declination."""
        dip, variation = np.radians([self.inclination_deg, self.declination_deg])
        north = self.field_gauss * np.cos(dip)
        return (
            float(north * np.cos(variation)),
            float(north * np.sin(variation)),
            float(self.field_gauss * np.sin(dip)),
        )

    @property
    def simulated(self) -> bool:
        """Whether the test is flown through the proxy."""
        return self.scenario is not None or self.estimator in SIMULATOR_ESTIMATORS


def read_test(path: Path | str) -> TestFile:
    """Read a test file, with the scenario it names inserted.

    Raises
    ------
    ConfigError
        If it cannot be read, or a key or value is wrong.
    """
    document = read_document(path)
    data = check_kind(document, TestFile.__struct_fields__, "a search")
    named = data.get("scenario")
    estimator = data.get("estimator", COMPILED_ESTIMATORS[0])
    if named is not None or estimator not in COMPILED_ESTIMATORS:
        # The file's own values override the defaults.
        data = {**SLOW_DEFAULTS, **data}
    if isinstance(named, str):
        data["scenario"] = msgspec.to_builtins(read_scenario(Path(path).parent / named))
    if isinstance(named, str | dict):
        duration_s = data["scenario"].get("duration_s", 120.0)
        # A scenario has no envelope by default.
        data = {"duration_s": duration_s, "envelope": NO_ENVELOPE, **data}
    return decode(document._replace(data=data), TestFile)

"""The scenario file: one flight with its vehicle, weather and sensors.

The sections `schedule`, `monitor` and `criteria` belong to other parts and pass through as they
are. Lengths in m, speeds in m/s, angles in degrees; the keys carry their units.
"""

from datetime import UTC, datetime
from importlib import resources
from pathlib import Path
from typing import Any, Literal

import msgspec

from mavproxy_fault.documents.document_check import DocumentCheck, decode
from mavproxy_fault.documents.document_kind import refuse_other_kinds
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.yaml_document import Document, read_document
from mavproxy_fault.documents.yaml_document import Path as DocumentPath
from simvehicle.gnss.gnss_config import GnssConfig
from simvehicle.sensors.airspeed import Airspeed
from simvehicle.sensors.barometer import Barometer
from simvehicle.sensors.battery import BatteryMonitor
from simvehicle.sensors.flow import OpticalFlow
from simvehicle.sensors.gps import Gps
from simvehicle.sensors.imu import ImuSensor
from simvehicle.sensors.magnetometer import Magnetometer
from simvehicle.sensors.rangefinder import Rangefinder
from simvehicle.sensors.vision import Vision

Shape = Literal["triangle", "diamond", "s", "eight", "trapezoid", "circle", "line"]


class _Section(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of the sections: unknown keys are errors."""


class StartState(_Section, frozen=True):
    """Motion at the start of a flight in the air, along and about the body's axes."""

    u_mps: float
    v_mps: float = 0.0
    w_mps: float = 0.0
    roll_deg: float = 0.0
    pitch_deg: float = 0.0
    p_dps: float = 0.0
    q_dps: float = 0.0
    r_dps: float = 0.0


class StartConfig(_Section, frozen=True):
    """Home and the beginning of the flight.

    `alt_m` is the ground's height above mean sea level at home, `geoid_m` the geoid's above the
    ellipsoid there; `height_m` above ground is where the vehicle starts, 0 means standing. In the
    air it starts in trimmed flight, or with `state`.
    """

    lat_deg: float = 47.397742
    lon_deg: float = 8.545594
    alt_m: float = 488.0
    geoid_m: float = 0.0
    height_m: float = 0.0
    heading_deg: float = 0.0
    state: StartState | None = None
    # Fixed, since the magnetic field and the sky depend on it.
    time: datetime = datetime(2024, 3, 7, 12, 0, tzinfo=UTC)

    def __post_init__(self) -> None:
        if not -90.0 <= self.lat_deg <= 90.0:
            raise ValueError(f"lat_deg = {self.lat_deg} is out of range; -90 to 90 is allowed")
        if not -180.0 <= self.lon_deg <= 180.0:
            raise ValueError(f"lon_deg = {self.lon_deg} is out of range; -180 to 180 is allowed")
        if self.height_m < 0.0:
            raise ValueError(f"height_m = {self.height_m} is below ground; 0 or more is allowed")
        # On the ground the vehicle stands: it has no motion to begin with.
        if self.state is not None and self.height_m == 0.0:
            raise ValueError("state needs a start in the air; height_m above 0")
        if self.time.tzinfo is None:
            raise ValueError("time has no time zone; write it like 2024-03-07T12:00:00Z")


class VehicleChoice(_Section, frozen=True):
    """Kind of vehicle (`kinds`) and its parameter set: a shipped name or a YAML file's path."""

    kind: str = "fixedwing"
    parameters: str = "aerosonde-2025"


class Leg(_Section, frozen=True):
    """One shape of the mission; it begins where the last one ended, in the same direction."""

    shape: Shape
    size_m: float = 600.0
    height_m: float = 100.0
    speed_mps: float | None = None  # None is the vehicle's cruise
    laps: int = 1

    def __post_init__(self) -> None:
        for name in ("size_m", "height_m", "laps"):
            if getattr(self, name) <= 0:
                raise ValueError(f"{name} = {getattr(self, name)} is not positive; above 0")
        if self.speed_mps is not None and self.speed_mps <= 0.0:
            raise ValueError(f"speed_mps = {self.speed_mps} is not positive; above 0")


class WeaveChoice(_Section, frozen=True):
    """Rolling from side to side by `roll_deg` while holding pitch and, for a fixed wing,
    airspeed; a quadrotor holds its height."""

    roll_deg: float
    period_s: float
    pitch_deg: float
    airspeed_mps: float | None = None

    def __post_init__(self) -> None:
        if self.period_s <= 0.0:
            raise ValueError(f"period_s = {self.period_s} is not positive; seconds above 0")


class OpenLoopControls(_Section, frozen=True):
    """Constant controls of a fixed wing in the place of a mission; `weave` adds feedback, and is
    all that a quadrotor has."""

    elevator_deg: float = 0.0
    aileron_deg: float = 0.0
    rudder_deg: float = 0.0
    throttle: float = 0.0
    weave: WeaveChoice | None = None


class GustChoice(_Section, frozen=True):
    """Dryden gusts by their own numbers, along the body's axes."""

    sigma_mps: tuple[float, float, float]
    length_m: tuple[float, float, float]

    def __post_init__(self) -> None:
        if min(self.sigma_mps) < 0.0:
            raise ValueError(f"sigma_mps = {list(self.sigma_mps)} is negative; 0 or more")
        if min(self.length_m) <= 0.0:
            raise ValueError(f"length_m = {list(self.length_m)} is not positive; metres above 0")


class ShearChoice(_Section, frozen=True):
    """Power law of the wind over height; `wind_ned_mps` is that at `reference_m`."""

    reference_m: float = 10.0  # where weather stations measure wind
    exponent: float = 1.0 / 7.0

    def __post_init__(self) -> None:
        if self.reference_m <= 0.0:
            raise ValueError(f"reference_m = {self.reference_m} is not positive; metres above 0")


class Environment(_Section, frozen=True):
    """Weather and ground.

    `terrain` is an ASCII raster of heights in m over degrees; without it the ground is level at
    `start.alt_m`, with it the raster says how high home is.
    """

    wind_ned_mps: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gusts: Literal["none", "light", "moderate", "light-600m", "moderate-600m"] | GustChoice = "none"
    shear: ShearChoice | None = None
    terrain: str | None = None


class SensorSuite(_Section, frozen=True):
    """The sensors on board; a list stands for several of a kind, with ids 0, 1, ..."""

    imu: ImuSensor | list[ImuSensor] = (
        ImuSensor()
    )  # always on board: its rate is that of the simulation's steps
    mag: Magnetometer | list[Magnetometer] | None = None
    baro: Barometer | list[Barometer] | None = None
    airspeed: Airspeed | None = None
    gps: Gps | list[Gps] | None = None
    range: Rangefinder | list[Rangefinder] | None = None
    flow: OpticalFlow | None = None
    vision: Vision | None = None
    battery: BatteryMonitor | None = None


class Scenario(_Section, frozen=True):
    """A whole scenario file."""

    name: str = "scenario"
    seed: int = 1
    duration_s: float = 120.0
    start: StartConfig = StartConfig()
    vehicle: VehicleChoice = VehicleChoice()
    mission: list[Leg] = []  # msgspec makes a new list for each scenario
    controls: OpenLoopControls | None = None
    environment: Environment = Environment()
    sensors: SensorSuite = SensorSuite()
    gnss: GnssConfig | None = None
    schedule: Any = None
    monitor: Any = None
    criteria: Any = None

    def __post_init__(self) -> None:
        if self.duration_s <= 0.0:
            raise ValueError(f"duration_s = {self.duration_s} is not positive; seconds above 0")
        if self.seed < 0:
            raise ValueError(f"seed = {self.seed} is negative; 0 or more is allowed")
        if self.controls is not None:
            self._check_controls(self.controls)

    def _check_controls(self, controls: OpenLoopControls) -> None:
        kind, weave = self.vehicle.kind, controls.weave
        if self.mission or kind not in ("fixedwing", "multirotor"):
            raise ValueError("controls fly a vehicle without a mission; leave one out")
        # Deflections are a fixed wing's; a quadrotor without feedback falls over.
        if kind == "multirotor" and (weave is None or controls != OpenLoopControls(weave=weave)):
            raise ValueError("controls of a multirotor are weave alone; leave the others out")
        if weave is not None and (weave.airspeed_mps is None) != (kind == "multirotor"):
            raise ValueError("controls.weave.airspeed_mps is for a fixed wing, which needs it")


def open_scenario(path: str | Path | None) -> Document:
    """The document of a scenario file, presets of sensors filled in; None gives the built-in demo.

    Raises
    ------
    ConfigError
        If the file cannot be read, is no YAML, or names sensors that there are not.
    """
    # In the package: the demo runs without any file.
    if path is None:
        path = Path(str(resources.files("simvehicle.scenario").joinpath("demo.yaml")))
    document = read_document(path)
    if not isinstance(document.data, dict):
        raise ConfigError(f"{document.where}:1: is no scenario; a mapping with keys is expected")
    refuse_other_kinds(document.data, Scenario.__struct_fields__, document.where, "a scenario")
    sensors = document.data.get("sensors")
    # A name of a file instead of a section.
    if isinstance(sensors, str):
        sensors = _sensor_file(Path(path).parent / sensors)
    elif isinstance(sensors, dict):
        sensors = _with_presets(document, ("sensors",))
    else:
        return document
    return document._replace(data={**document.data, "sensors": sensors})


def read_scenario(path: str | Path | None) -> Scenario:
    """Read a scenario file; None gives the built-in demo.

    Raises
    ------
    ConfigError
        If something in the file is wrong; the text names file, line and what is allowed.
    """
    return decode_scenario(open_scenario(path))


def decode_scenario(document: Document) -> Scenario:
    """The scenario of a document that `open_scenario` gave.

    Raises
    ------
    ConfigError
        With every key and value that is wrong.
    """
    # Relative to the scenario, wherever the command was started.
    return _resolve_files(decode(document, Scenario), Path(document.where).parent)


def _resolve_files(scenario: Scenario, folder: Path) -> Scenario:
    """Names of files in a scenario count from the scenario's own folder."""
    vehicle, gnss, weather = scenario.vehicle, scenario.gnss, scenario.environment
    if vehicle.parameters.endswith((".yaml", ".yml")):
        parameters = str(folder / vehicle.parameters)
        vehicle = msgspec.structs.replace(vehicle, parameters=parameters)
    if gnss is not None and gnss.navigation is not None:
        gnss = msgspec.structs.replace(gnss, navigation=str(folder / gnss.navigation))
    if weather.terrain is not None:
        weather = msgspec.structs.replace(weather, terrain=str(folder / weather.terrain))
    return msgspec.structs.replace(scenario, vehicle=vehicle, gnss=gnss, environment=weather)


def _sensor_file(path: Path) -> dict[str, Any]:
    """The `sensors` of a scenario from a file of their own, checked there."""
    document = read_document(path)
    if not isinstance(document.data, dict):
        raise ConfigError(f"{path}:1: holds no sensors; a mapping like imu: {{...}} is expected")
    sensors = _with_presets(document, ())
    # Checked here, so that errors name this file and its lines.
    decode(document._replace(data=sensors), SensorSuite)
    return sensors


def _with_presets(document: Document, at: DocumentPath) -> dict[str, Any]:
    """The sensors at a path of a document, each `preset: name` replaced by the preset's values.

    What is given beside a preset has precedence. Several sensors of a kind get their ids.
    """
    # Read at each call: a scenario is read once, and the file is small.
    presets = read_document(Path(str(resources.files("simvehicle.sensors"))) / "presets.yaml").data
    check = DocumentCheck(document.where, document.lines)
    sensors = document.data[at[0]] if at else document.data
    out: dict[str, Any] = {}
    for kind, value in sensors.items():
        known = presets.get(kind, {})
        if isinstance(value, list):
            filled = [
                _apply_preset(entry, known, check, (*at, kind, index))
                for index, entry in enumerate(value)
            ]
            out[kind] = [
                # Numbered as listed, unless the entry numbers itself.
                {"id": index, **entry} if isinstance(entry, dict) else entry
                for index, entry in enumerate(filled)
            ]
        else:
            out[kind] = _apply_preset(value, known, check, (*at, kind))
    check.finish()
    return out


def _apply_preset(
    entry: Any, known: dict[str, Any], check: DocumentCheck, path: DocumentPath
) -> Any:
    """A sensor with the values of its preset under its own."""
    if not isinstance(entry, dict) or "preset" not in entry:
        return entry
    name = entry["preset"]
    if not isinstance(name, str) or name not in known:
        names = ", ".join(known) or "none"
        check.wrong((*path, "preset"), f"= {name} is unknown; known: {names}")
        return entry
    # The entry's own keys come last, so that they win.
    return {**known[name], **{key: value for key, value in entry.items() if key != "preset"}}

"""The scenario file: one flight with its vehicle, weather and sensors.

The sections `schedule`, `monitor`, `criteria` and `requirements` are decoded elsewhere. Lengths are
in m, speeds in m/s, angles in degrees; each key ends in its unit.
"""

from datetime import UTC, datetime
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from mavproxy_fault.documents.document_check import (
    DocumentCheck,
    NotNegative,
    Positive,
    Section,
    decode,
)
from mavproxy_fault.documents.document_kind import check_kind
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.yaml_document import Document, read_document
from mavproxy_fault.documents.yaml_document import Path as DocumentPath
from simvehicle.environment.air import Gusts
from simvehicle.gnss.gnss_config import GnssConfig
from simvehicle.sensors.airspeed import Airspeed
from simvehicle.sensors.barometer import Barometer
from simvehicle.sensors.battery import BatteryMonitor
from simvehicle.sensors.flow import OpticalFlow
from simvehicle.sensors.gps import Gps
from simvehicle.sensors.imu import ImuSensor
from simvehicle.sensors.magnetometer import Magnetometer
from simvehicle.sensors.rangefinder import Rangefinder
from simvehicle.sensors.remote_control import RemoteControl
from simvehicle.sensors.vision import Vision

Shape = Literal["triangle", "diamond", "s", "eight", "trapezoid", "circle", "line"]


class StartState(Section, frozen=True):
    """Motion at the start of a flight in the air, along and about the body axes."""

    u_mps: float
    v_mps: float = 0.0
    w_mps: float = 0.0
    roll_deg: float = 0.0
    pitch_deg: float = 0.0
    p_dps: float = 0.0
    q_dps: float = 0.0
    r_dps: float = 0.0


class StartConfig(Section, frozen=True):
    """Home and the start of the flight.

    `alt_m` is the ground's height above mean sea level at home, `geoid_m` the geoid's height above
    the ellipsoid. The vehicle starts `height_m` above ground: 0 means standing on the ground,
    otherwise it starts in trimmed flight, or with `state`.
    """

    lat_deg: Annotated[float, Meta(ge=-90, le=90)] = 47.397742
    lon_deg: Annotated[float, Meta(ge=-180, le=180)] = 8.545594
    alt_m: float = 488.0
    geoid_m: float = 0.0
    height_m: NotNegative = 0.0
    heading_deg: float = 0.0
    state: StartState | None = None
    # Fixed, as the magnetic field depends on it.
    time: datetime = datetime(2024, 3, 7, 12, 0, tzinfo=UTC)

    def __post_init__(self) -> None:
        # On the ground the vehicle starts at rest.
        if self.state is not None and self.height_m == 0.0:
            raise ValueError("state needs a start in the air; set height_m above 0")
        if self.time.tzinfo is None:
            raise ValueError("time has no time zone; write it like 2024-03-07T12:00:00Z")


class VehicleChoice(Section, frozen=True):
    """Kind of vehicle (`kinds`) and its parameter set: a shipped name or a YAML file's path."""

    kind: str = "fixedwing"
    parameters: str = "aerosonde-2025"


class Leg(Section, frozen=True):
    """One shape of the mission; it starts where the previous one ended, with the same heading."""

    shape: Shape
    size_m: Positive = 600.0
    height_m: Positive = 100.0
    speed_mps: Positive | None = None  # None: the vehicle's cruise speed
    laps: Annotated[int, Meta(ge=1)] = 1


class WeaveChoice(Section, frozen=True):
    """Rolling from side to side by `roll_deg` at constant pitch and, for a fixed wing, constant
    airspeed; a quadrotor keeps its height."""

    roll_deg: float
    period_s: Positive
    pitch_deg: float
    airspeed_mps: float | None = None


class OpenLoopControls(Section, frozen=True):
    """Constant controls of a fixed wing instead of a mission; `weave` adds feedback. A quadrotor
    takes `weave` only."""

    elevator_deg: float = 0.0
    aileron_deg: float = 0.0
    rudder_deg: float = 0.0
    throttle: float = 0.0
    weave: WeaveChoice | None = None


class ShearChoice(Section, frozen=True):
    """Wind shear as a power law over height; `wind_ned_mps` is the wind at `reference_m`."""

    reference_m: Positive = 10.0  # height of weather station wind
    exponent: float = 1.0 / 7.0  # the one-seventh power law of neutral air over open land


class Environment(Section, frozen=True):
    """Weather and ground.

    `terrain` is an ASCII raster of heights [m] over degrees, which then also gives the height of
    home; without it the ground is level at `start.alt_m`.
    """

    wind_ned_mps: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gusts: Literal["none", "light", "moderate", "light-600m", "moderate-600m"] | Gusts = "none"
    shear: ShearChoice | None = None
    terrain: str | None = None


class SensorSuite(Section, frozen=True):
    """The sensors on board; a list has several of one kind, with ids 0, 1, ..."""

    # Always on board: its rate sets the simulation's step
    imu: ImuSensor | list[ImuSensor] = ImuSensor()
    mag: Magnetometer | list[Magnetometer] | None = None
    baro: Barometer | list[Barometer] | None = None
    airspeed: Airspeed | None = None
    gps: Gps | list[Gps] | None = None
    range: Rangefinder | list[Rangefinder] | None = None
    flow: OpticalFlow | None = None
    vision: Vision | None = None
    battery: BatteryMonitor | None = None
    remote_control: RemoteControl | None = None


class Scenario(Section, frozen=True):
    """A complete scenario file."""

    name: str = "scenario"
    seed: Annotated[int, Meta(ge=0)] = 1
    duration_s: Positive = 120.0
    start: StartConfig = StartConfig()
    vehicle: VehicleChoice = VehicleChoice()
    mission: list[Leg] = msgspec.field(default_factory=list)
    controls: OpenLoopControls | None = None
    environment: Environment = Environment()
    sensors: SensorSuite = SensorSuite()
    gnss: GnssConfig | None = None
    schedule: Any = None
    monitor: Any = None
    criteria: Any = None
    requirements: Any = None

    def __post_init__(self) -> None:
        if self.controls is not None:
            self._check_controls(self.controls)

    def _check_controls(self, controls: OpenLoopControls) -> None:
        kind, weave = self.vehicle.kind, controls.weave
        if self.mission or kind not in ("fixedwing", "multirotor"):
            raise ValueError("controls need a fixedwing or multirotor without mission; remove one")
        # A quadrotor has no surfaces and is unstable without feedback.
        if kind == "multirotor" and (weave is None or controls != OpenLoopControls(weave=weave)):
            raise ValueError(
                "controls of a multirotor must be weave alone; add it or remove the others"
            )
        if weave is not None and (weave.airspeed_mps is None) != (kind == "multirotor"):
            raise ValueError(
                "controls.weave.airspeed_mps is for a fixed wing only, which needs it; "
                f"{'remove' if kind == 'multirotor' else 'add'} it"
            )


def open_scenario(path: str | Path | None) -> Document:
    """The document of a scenario file with sensor presets filled in; None gives the demo.

    Raises
    ------
    ConfigError
        If the file cannot be read, is not YAML, or names an unknown sensor preset.
    """
    # The demo is part of the package, so it runs without a file.
    if path is None:
        path = Path(str(resources.files("simvehicle.scenario").joinpath("demo.yaml")))
    document = read_document(path)
    keys = check_kind(document, Scenario.__struct_fields__, "a scenario")
    sensors = keys.get("sensors")
    # A file name instead of a section.
    if isinstance(sensors, str):
        sensors = _sensor_file(Path(path).parent / sensors)
    elif isinstance(sensors, dict):
        sensors = _with_presets(document, ("sensors",))
    else:
        return document
    return document._replace(data={**keys, "sensors": sensors})


def read_scenario(path: str | Path | None) -> Scenario:
    """Read a scenario file; None gives the built-in demo.

    Raises
    ------
    ConfigError
        If the file has an error; the text names file, line and what is allowed.
    """
    return decode_scenario(open_scenario(path))


def decode_scenario(document: Document) -> Scenario:
    """Decode the scenario of a document from `open_scenario`.

    Raises
    ------
    ConfigError
        Lists every invalid key and value.
    """
    # File names are relative to the scenario, not to the working directory.
    return _resolve_files(decode(document, Scenario), Path(document.where).parent)


def _resolve_files(scenario: Scenario, folder: Path) -> Scenario:
    """Resolve file names in a scenario relative to the scenario's folder."""
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
    """Read and check the `sensors` of a scenario from a separate file."""
    document = read_document(path)
    if not isinstance(document.data, dict):
        raise ConfigError(f"{path}:1: has no sensors; write a mapping like imu: {{...}}")
    sensors = _with_presets(document, ())
    # Checked here, so that errors name this file and its lines.
    decode(document._replace(data=sensors), SensorSuite)
    return sensors


def _with_presets(document: Document, at: DocumentPath) -> dict[str, Any]:
    """The sensors at a path of a document, with each `preset: name` replaced by its values.

    Keys next to a preset take precedence. Several sensors of one kind get their ids.
    """
    # Not cached: a scenario is read once, and the file is small.
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
            # The id is the index in the list, unless the entry has one.
            out[kind] = [
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
    """A sensor's entry with the values of its preset for the missing keys."""
    if not isinstance(entry, dict) or "preset" not in entry:
        return entry
    name = entry["preset"]
    if not isinstance(name, str) or name not in known:
        names = ", ".join(known) or "none"
        check.wrong((*path, "preset"), f"= {name} is unknown; known: {names}")
        return entry
    # The entry's own keys come last, so that they take precedence.
    return {**known[name], **{key: value for key, value in entry.items() if key != "preset"}}

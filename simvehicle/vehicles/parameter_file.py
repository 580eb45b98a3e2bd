"""The common part of vehicle parameter files: location, mass, gear and battery."""

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar, cast

from mavproxy_fault.documents.document_check import Section, decode
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.yaml_document import Document, read_document
from simvehicle.vehicles.battery_kernel import BatterySupply
from simvehicle.vehicles.rigidbody_kernel import Inertia, inertia_coefficients

T = TypeVar("T")
SHIPPED = Path(__file__).parent / "parameters"


class InertiaMoments(Section, frozen=True):
    """Moments of inertia about the centre of mass [kg m^2]."""

    jx: float
    jy: float
    jz: float
    jxz: float = 0.0


class BatteryParameters(Section, frozen=True):
    """A lithium-polymer pack, modelled in `battery_kernel`.

    `full_throttle_a` is the current at full throttle, for a vehicle without a motor model.
    """

    cells: int
    capacity_ah: float
    resistance_ohm: float
    full_throttle_a: float = 0.0

    def supply(self, plant: Mapping[str, float]) -> BatterySupply:
        """The pack in the kernel's form, with plant faults."""
        return BatterySupply(
            self.cells,
            self.capacity_ah,
            self.resistance_ohm,
            self.full_throttle_a,
            plant.get("battery_voltage_scale", 1.0),
            plant.get("battery_resistance_scale", 1.0),
        )


class VehicleParameters(Section, frozen=True):
    """What all vehicles have; `gear_m` are the points that touch the ground, in body axes."""

    name: str
    source: str
    mass_kg: float
    inertia_kgm2: InertiaMoments
    gear_m: list[tuple[float, float, float]]
    battery: BatteryParameters
    cruise_mps: float

    def __post_init__(self) -> None:
        body_inertia(self, {})  # refuses impossible moments of inertia


def body_inertia(parameters: VehicleParameters, plant: Mapping[str, float]) -> Inertia:
    """Mass and inertia, with the plant faults `mass_kg_add` and `inertia_scale`."""
    # All scaled together, so that the principal axes stay.
    j, scale = parameters.inertia_kgm2, plant.get("inertia_scale", 1.0)
    mass = parameters.mass_kg + plant.get("mass_kg_add", 0.0)
    return inertia_coefficients(mass, scale * j.jx, scale * j.jy, scale * j.jz, scale * j.jxz)


def parameter_path(name: str | Path) -> Path:
    """The path of a shipped parameter set by name, or the given YAML path.

    Raises
    ------
    ConfigError
        If there is no such set.
    """
    path = Path(name)
    # A name without a suffix is a shipped set.
    if path.suffix not in (".yaml", ".yml"):
        path = SHIPPED / f"{name}.yaml"
        if not path.is_file():
            known = ", ".join(sorted(p.stem for p in SHIPPED.glob("*.yaml")))
            raise ConfigError(
                f"vehicle.parameters: {name} is unknown; known: {known}, or the path of a YAML file"
            )
    return path


def read_parameters(name: str | Path, kind: type[T]) -> T:
    """Read a shipped parameter set by name, or a file by its path.

    Raises
    ------
    ConfigError
        If there is no such set or file, or its content is invalid.
    """
    path = parameter_path(name)
    return cast(T, _parameters_at(path, _changed_ns(path), cast(Any, kind)))


def parameter_document(name: str | Path) -> Document:
    """Read a shipped parameter set or a file, before its content is checked; raises as
    `read_parameters` does."""
    path = parameter_path(name)
    return _document_at(path, _changed_ns(path))


def _changed_ns(path: Path) -> int:
    return path.stat().st_mtime_ns if path.is_file() else 0


# Kept, as a third of the time of a search's flight would go to them.
@lru_cache(maxsize=8)
def _parameters_at(path: Path, changed_ns: int, kind: type) -> object:
    return decode(_document_at(path, changed_ns), kind)


@lru_cache(maxsize=8)
def _document_at(path: Path, _changed_ns: int) -> Document:
    return read_document(path)

"""The common part of vehicle parameter files: location, moments of inertia, battery."""

from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Protocol, TypeVar

import msgspec

from mavproxy_fault.documents.document_check import decode
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.yaml_document import read_document
from simvehicle.vehicles.battery_kernel import BatterySupply
from simvehicle.vehicles.rigidbody_kernel import Inertia, inertia_coefficients

T = TypeVar("T")


class InertiaMoments(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Moments of inertia about the centre of mass [kg m^2]."""

    jx: float
    jy: float
    jz: float
    jxz: float = 0.0


class HasMass(Protocol):
    """Parameters with mass and moments of inertia."""

    @property
    def mass_kg(self) -> float:
        """Mass of the complete vehicle."""

    @property
    def inertia_kgm2(self) -> InertiaMoments:
        """Moments of inertia about its centre of mass."""


def body_inertia(parameters: HasMass, plant: Mapping[str, float]) -> Inertia:
    """Mass and inertia, with the plant faults `mass_kg_add` and `inertia_scale`."""
    # All scaled together, so that the principal axes stay.
    j, scale = parameters.inertia_kgm2, plant.get("inertia_scale", 1.0)
    mass = parameters.mass_kg + plant.get("mass_kg_add", 0.0)
    return inertia_coefficients(mass, scale * j.jx, scale * j.jy, scale * j.jz, scale * j.jxz)


class BatteryParameters(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A lithium-polymer pack, modelled in `battery_kernel`.

    `full_throttle_a` is the current at full throttle, for a vehicle without a motor model.
    """

    cells: int
    capacity_ah: float
    resistance_ohm: float
    full_throttle_a: float = 0.0

    def supply(
        self, full_throttle_a: float, voltage_scale: float, resistance_scale: float
    ) -> BatterySupply:
        """The pack in the kernel's form, with plant faults."""
        return BatterySupply(
            self.cells, self.capacity_ah, self.resistance_ohm, full_throttle_a,
            voltage_scale, resistance_scale,
        )  # fmt: skip


def parameter_path(name: str | Path) -> Path:
    """The path of a shipped parameter set by name, or the given YAML path.

    Raises
    ------
    ConfigError
        If there is no such set.
    """
    shipped = Path(str(resources.files("simvehicle.vehicles") / "parameters"))
    path = Path(name)
    # A name without a suffix is a shipped set.
    if path.suffix not in (".yaml", ".yml"):
        path = shipped / f"{name}.yaml"
        if not path.is_file():
            known = ", ".join(sorted(p.stem for p in shipped.glob("*.yaml")))
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
    return decode(read_document(parameter_path(name)), kind)

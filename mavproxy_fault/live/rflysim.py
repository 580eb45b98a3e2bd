"""RflySim's fault packets and the map from its fault ids to our faults.

A `PX4SILIntFloat` is 120 bytes: checksum, CopterID, eight fault ids and twenty parameters; slot i
of the ids owns parameters 2i and 2i + 1, and a fault with more parameters repeats its id. Without
its head it is 112 bytes, ids or parameters first, of vehicle 1. Faults
latch; 123549 means "no fault". The ids differ between RflySim's models, so the map is a YAML file:

    123452: {kind: sensor, target: [HIL_SENSOR.xacc, HIL_SENSOR.yacc, HIL_SENSOR.zacc], sigma: 0.5}
    123450: {kind: motor, target: HIL_ACTUATOR_CONTROLS.controls}
    123544: {kind: plant, target: [PLANT.wind_n_mps, PLANT.wind_e_mps]}
"""

import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from mavproxy_fault.documents.document_check import DocumentCheck
from mavproxy_fault.documents.yaml_document import read_document

PACKED = struct.Struct("<10i20f")
BARE, BARE_IDS_FIRST = struct.Struct("<20f8i"), struct.Struct("<8i20f")
CHECKSUM = 1234567897
NO_FAULT = 123549
FIRST_PORT = 30100  # of vehicle 1; each further vehicle adds two

# First parameter of a sensor fault.
NOISE_AND_BIAS, SCALE_FACTOR = 3, 4
DEFAULT_MAP = Path(__file__).parents[1] / "schedule" / "presets" / "rflysim" / "faultmodel.yaml"


def _is_id(number: int) -> bool:
    """Whether a number may be a fault id: RflySim's have six digits; 0 is an empty slot."""
    return number == 0 or 100_000 <= number <= 999_999


class Packet(msgspec.Struct, frozen=True):
    """One packet: the vehicle and the parameters of each of its fault ids."""

    vehicle: int
    faults: dict[int, tuple[float, ...]]
    clears: bool

    @staticmethod
    def read(data: bytes) -> "Packet | None":
        """Parse a datagram; None if it is one of RflySim's other structs."""
        if len(data) == BARE.size:
            return Packet._read_bare(data)
        if len(data) != PACKED.size:
            return None
        numbers = PACKED.unpack(data)
        if numbers[0] != CHECKSUM:
            return None
        return Packet._of(numbers[1], numbers[2:10], numbers[10:30])

    @staticmethod
    def _read_bare(data: bytes) -> "Packet | None":
        """Parse a packet without its head; None unless it is plain which way round it is."""
        floats_first, ids_first = BARE.unpack(data), BARE_IDS_FIRST.unpack(data)
        shapes = [(floats_first[20:], floats_first[:20]), (ids_first[:8], ids_first[8:])]
        plain = [one for one in shapes if any(one[0]) and all(map(_is_id, one[0]))]
        return Packet._of(1, *plain[0]) if len(plain) == 1 else None

    @staticmethod
    def _of(vehicle: int, ids: Sequence[int], parameters: Sequence[float]) -> "Packet":
        faults: dict[int, tuple[float, ...]] = {}
        for slot, id in enumerate(ids):
            if id not in (0, NO_FAULT):
                # A fault with more than two parameters repeats its id; its pairs are joined.
                faults[id] = faults.get(id, ()) + tuple(parameters[2 * slot : 2 * slot + 2])
        return Packet(vehicle, faults, NO_FAULT in ids)


class FaultMeaning(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The meaning of a fault id.

    The parameters of a motor fault are factors on its commands; those of a sensor fault are a mode
    (3: noise and bias per axis, 4: scale factor) and numbers per axis, `sigma` is the noise at
    gain 1; those of a plant fault are the targets' values times `scale`, unless `value` is given.
    """

    kind: Literal["motor", "sensor", "plant"]
    target: str | tuple[str, ...]
    sigma: float = 0.0
    floor: Annotated[float, Meta(ge=0, le=1)] = 0.2
    scale: float = 1.0
    value: float | None = None

    @property
    def targets(self) -> list[str]:
        """The targets as a list."""
        return [self.target] if isinstance(self.target, str) else list(self.target)


IdMap = dict[int, FaultMeaning]  # by RflySim's id


def packet_entries(meanings: IdMap, packet: Packet) -> list[dict[str, Any]]:
    """Return the schedule entries of a packet; ids missing from the map are ignored."""
    found = []
    for id, parameters in packet.faults.items():
        meaning = meanings.get(id)
        if meaning is None:
            continue
        make = {"motor": _motor, "sensor": _sensor, "plant": _plant}[meaning.kind]
        for number, entry in enumerate(make(meaning, parameters), 1):
            found.append({"id": f"rflysim-{packet.vehicle}-{id}.{number}", **entry})
    return found


def read_map(path: Path | str = DEFAULT_MAP) -> IdMap:
    """Read the id map of a YAML file.

    Raises
    ------
    ConfigError
        If the file has errors: all of them, with their lines.
    """
    document = read_document(path)
    check = DocumentCheck(document.where, document.lines)
    meanings = {}
    for id, value in document.data.items() if isinstance(document.data, dict) else ():
        # Only ASCII digits: `int` accepts others too.
        if not (id.isascii() and id.isdigit()):
            check.wrong((id,), "is not a fault id; give an integer such as 123450")
            continue
        meanings[int(id)] = check.struct(value, FaultMeaning, (id,))
    check.finish()
    return meanings


def _motor(meaning: FaultMeaning, parameters: tuple[float, ...]) -> list[dict[str, Any]]:
    """Return one scale fault for each motor."""
    return [
        {"fault": "scale", "target": f"{target}[{motor}]", "value": factor}
        for target in meaning.targets
        for motor, factor in enumerate(parameters)
    ]


def _sensor(meaning: FaultMeaning, parameters: tuple[float, ...]) -> list[dict[str, Any]]:
    """Return noise (floor + (1 - floor) gain) sigma and bias per axis, or a scale factor."""
    mode, numbers = round(parameters[0]), parameters[1:]
    targets = meaning.targets
    if mode == SCALE_FACTOR:
        return [{"fault": "scale", "target": targets, "value": numbers[0]}]
    if mode != NOISE_AND_BIAS:
        return []
    entries: list[dict[str, Any]] = []
    # A missing gain is zero, which leaves the floor of the noise.
    for target, bias, gain in zip(targets, numbers[::2], (*numbers[1::2], 0.0), strict=False):
        share = meaning.floor + (1.0 - meaning.floor) * gain
        entries.append({"fault": "bias", "target": target, "value": bias * meaning.scale})
        if meaning.sigma:
            entries.append(
                {"fault": "noise", "target": target, "value": abs(share) * meaning.sigma}
            )
    return entries


def _plant(meaning: FaultMeaning, parameters: tuple[float, ...]) -> list[dict[str, Any]]:
    values = [value * meaning.scale for value in parameters]
    if meaning.value is not None:
        values = [meaning.value] * len(meaning.targets)
    return [
        {"fault": "plant", "target": target, "value": value}
        # Targets without a value stay healthy.
        for target, value in zip(meaning.targets, values, strict=False)
    ]

"""All faults by name; other packages add theirs by entry point (group `mavproxy_fault.faults`)."""

from functools import cache
from typing import Any

from mavproxy_fault.faults import (
    axes,
    damage,
    driven,
    freeze,
    late,
    loss,
    spoof,
    stamps,
    timing,
    waves,
)
from mavproxy_fault.faults import bit_faults as bits
from mavproxy_fault.faults import noise_fault as noise
from mavproxy_fault.faults import plant_fault as plant
from mavproxy_fault.faults import sensor_curve as shape

OURS: dict[str, type[Any]] = {
    "axis-swap": axes.AxisSwap,
    "bias": driven.Bias,
    "bit-flip": bits.BitFlip,
    "burst-loss": loss.Burst,
    "clear-bits": bits.ClearBits,
    "constant": driven.Constant,
    "corrupt": damage.Corrupt,
    "cycle": waves.Cycle,
    "dead-band": shape.DeadBand,
    "delay": timing.Delay,
    "drift": driven.Drift,
    "drop": loss.Drop,
    "duplicate": timing.Duplicate,
    "float": freeze.Float,
    "freeze": freeze.Freeze,
    "gilbert-elliott": loss.GilbertElliott,
    "gps-spoof": spoof.GpsSpoof,
    "impulse": waves.Impulse,
    "iron": axes.Iron,
    "jitter": timing.Jitter,
    "lag": late.Lag,
    "noise": noise.Noise,
    "not-a-number": bits.NotANumber,
    "outage": loss.Outage,
    "plant": plant.Plant,
    "quantise": shape.Quantise,
    "random-walk": noise.RandomWalk,
    "rate-limit": loss.RateLimit,
    "reorder": timing.Reorder,
    "replay": freeze.Replay,
    "rotation": axes.Rotation,
    "sample-hold": late.SampleHold,
    "saturate": shape.Saturate,
    "scale": driven.Scale,
    "sequence-gap": damage.SequenceGap,
    "sine": waves.Sine,
    "slew-limit": freeze.SlewLimit,
    "time-backwards": stamps.TimeBackwards,
    "time-drift": stamps.TimeDrift,
    "time-jump": stamps.TimeJump,
    "truncate": damage.Truncate,
}
ALIASES = {"stuck": "freeze", "ramp": "drift", "nan": "not-a-number", "quantize": "quantise"}

# Faults whose error does not depend on the healthy value: these act on PSEUDORANGE targets too.
ON_RANGES = ("bias", "cycle", "drift", "drop", "impulse", "noise", "random-walk", "sine")


@cache
def known_faults() -> dict[str, type[Any]]:
    """Name to class, sorted by name; aliases are left out."""
    from importlib.metadata import entry_points  # a twentieth of a second, for what few have

    others = {point.name: point.load() for point in entry_points(group="mavproxy_fault.faults")}
    return dict(sorted({**others, **OURS}.items()))


def fault_class(name: str) -> type[Any] | None:
    """The class of a fault by its name or alias; None if there is none."""
    name = ALIASES.get(name, name)
    return OURS.get(name) or known_faults().get(name)

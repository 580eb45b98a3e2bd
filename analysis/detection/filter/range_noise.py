"""The noise of pseudoranges and Doppler rates as a function of elevation and C/N0."""

import math
from functools import cached_property
from typing import NamedTuple

import msgspec
import numpy as np

from analysis.samples.sample import Vector
from mavproxy_fault.documents.document_check import NotNegative, Positive
from mavproxy_fault.numerics.compile import compiled


class SigmaNumbers(NamedTuple):
    """The white-noise terms of `SigmaModel`, in the form that kernels read."""

    scale: float
    floor_m: float
    zenith_m: float
    thermal_m: float
    rate_mps: float
    lasting_s: float
    systems: tuple[float, ...]


class SigmaModel(msgspec.Struct, frozen=True, kw_only=True, dict=True):
    """One sigma of a pseudorange from elevation and C/N0.

    sigma^2 = scale^2 (floor^2 + (zenith / sin(elevation))^2 + thermal^2 10^((45 - C/N0) / 10))

    Only the last term is white where `lasting_s` is given, the correlation time of the others
    (0: all of them are white).

    Errors that last for minutes (multipath, ephemeris and atmosphere residuals) must not trip the
    tests with memory: those allow an offset of `slow` times sigma with a correlation time of
    `slow_s`, and a slope of `slow_mps`. `rate_mps` is one sigma of a Doppler rate in the zenith.
    `systems` are factors by clock: GPS with QZSS, Galileo, GLONASS, whose channels have delays of
    their own (RTKLIB's factor), and BeiDou, whose B3I wanders as much on a recorded walk
    (benchmarks/fdi_walk.py).
    """

    scale: Positive = 1.0
    floor_m: Positive = 0.3
    zenith_m: NotNegative = 0.4
    thermal_m: NotNegative = 0.3
    slow: NotNegative = 1.0
    slow_s: Positive = 300.0
    slow_mps: NotNegative = 0.02
    lasting_s: NotNegative = 0.0
    rate_mps: Positive = 0.15
    systems: tuple[Positive, Positive, Positive, Positive] = (1.0, 1.0, 1.5, 1.5)

    def sigma_m(self, elevation_rad: Vector, cn0_dbhz: Vector) -> Vector:
        """One sigma (n,) of each pseudorange; C/N0 counts as 45 dBHz where it is unknown."""
        pairs = zip(elevation_rad.tolist(), cn0_dbhz.tolist(), strict=True)
        return np.sqrt([range_variance(*pair, self.numbers)[0] for pair in pairs])

    @cached_property
    def numbers(self) -> SigmaNumbers:
        """The terms that the kernels need."""
        *names, _ = SigmaNumbers._fields
        terms = {name: float(getattr(self, name)) for name in names}
        return SigmaNumbers(**terms, systems=tuple(map(float, self.systems)))


@compiled
def range_variance(
    elevation_rad: float, cn0_dbhz: float, sigma: SigmaNumbers
) -> tuple[float, float]:
    """Variance of a pseudorange in m^2, and the thermal part of it."""
    # A negative C/N0 is no signal; it must not make the variance explode.
    cn0 = max(cn0_dbhz, 0.0) if math.isfinite(cn0_dbhz) else 45.0
    sine = math.sin(max(elevation_rad, 0.05))
    thermal = (sigma.scale * sigma.thermal_m) ** 2 * 10.0 ** ((45.0 - cn0) / 10.0)
    lasting = sigma.scale**2 * (sigma.floor_m**2 + (sigma.zenith_m / sine) ** 2)
    return lasting + thermal, thermal

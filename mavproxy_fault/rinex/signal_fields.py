"""Writes a changed signal to the observation fields of a satellite in a RINEX file."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mavproxy_fault.numerics.constants import SPEED_OF_LIGHT_MPS
from mavproxy_fault.numerics.signal_noise import code_sigma_m, rate_sigma_mps
from mavproxy_fault.rinex.observation_header import FIELD, ObservationField
from mavproxy_fault.rinex.signal_change import SignalChange

VALUE = 14  # F14.3, before loss of lock and signal strength
LOCK_DBHZ = 25.0  # weaker signals are lost; same as the simulated receiver
USUAL_DBHZ = 45.0  # chosen: typical in the open sky, for files without S fields
CODES = "CP"  # P is the code of the encrypted signal in RINEX 2
# Carriers by system and band: RINEX 3.05, tables 4 (GPS), 6 (Galileo), 8 (QZSS) and 9 (BeiDou).
CARRIERS_MHZ = {
    "G": {"1": 1575.42, "2": 1227.6, "5": 1176.45},
    "E": {"1": 1575.42, "5": 1176.45, "7": 1207.14, "8": 1191.795, "6": 1278.75},
    "J": {"1": 1575.42, "2": 1227.6, "5": 1176.45, "6": 1278.75},
    "C": {"1": 1575.42, "2": 1561.098, "5": 1176.45, "7": 1207.14, "8": 1191.795, "6": 1268.52},
}


def write_change(
    lines: list[str],
    observations: Sequence[ObservationField],
    satellite: str,
    change: SignalChange,
    rng: np.random.Generator,
) -> None:
    """Write a changed signal to the fields of its satellite, in place.

    A weaker signal gets noise, the difference in thermal noise between the new and the old C/N0,
    and is lost below `LOCK_DBHZ`; the fields of a lost signal are blank, "not observed".
    """
    strengths = {o.signal: number_in(lines, o) for o in observations if o.name[0] == "S"}
    for signal in sorted({o.signal for o in observations}):
        own = [o for o in observations if o.signal == signal]
        before = strengths.get(signal) or USUAL_DBHZ
        after = before - change.drop_db
        lost = change.lost or (change.drop_db > 0.0 and after < LOCK_DBHZ)
        noise_m, noise_mps = rng.standard_normal(2) * _extra_sigma(before, min(before, after))
        carrier_mhz = CARRIERS_MHZ.get(satellite[0], {}).get(signal[0], math.inf)
        wave_m = SPEED_OF_LIGHT_MPS * 1e-6 / carrier_mhz
        added = {code: change.code_m + change.signal_m + float(noise_m) for code in CODES}
        if wave_m:  # with an unknown carrier, the phase stays
            added["L"] = change.signal_m / wave_m
            # The Doppler shift of an approaching satellite is positive.
            added["D"] = -(change.rate_mps + float(noise_mps)) / wave_m
        added["S"] = -change.drop_db
        for observation in own:
            _write(lines, observation, math.nan if lost else added.get(observation.name[0], 0.0))


def has_range(lines: Sequence[str], observations: Sequence[ObservationField]) -> bool:
    """Whether a satellite has a code range."""
    return any(o.name[0] in CODES and number_in(lines, o) is not None for o in observations)


def _extra_sigma(before_dbhz: float, after_dbhz: float) -> NDArray[np.float64]:
    """Return the standard deviations (2,) of the added noise of range [m] and rate [m/s]."""
    strengths = np.array([after_dbhz, before_dbhz])
    variances = np.array([code_sigma_m(strengths), rate_sigma_mps(strengths)]) ** 2
    return np.asarray(np.sqrt(variances[:, 0] - variances[:, 1]))


def number_in(lines: Sequence[str], observation: ObservationField) -> float | None:
    """Read a field; None if it is blank, damaged or zero, "not observed" in RINEX."""
    column = observation.column
    try:
        value = float(lines[observation.at][column : column + VALUE])
    except ValueError:
        return None
    return value / observation.scale if value != 0.0 and math.isfinite(value) else None


def _write(lines: list[str], observation: ObservationField, added: float) -> None:
    """Add to the number of a field; NaN makes it blank."""
    before, column = number_in(lines, observation), observation.column
    if before is None or added == 0.0:
        return
    line = lines[observation.at].ljust(column + FIELD)
    stored = (before + added) * observation.scale
    value, marks = f"{stored:{VALUE}.3f}", line[column + VALUE : column + FIELD]
    if math.isnan(added):
        value, marks = " " * VALUE, " " * (FIELD - VALUE)
    lines[observation.at] = (line[:column] + value + marks + line[column + FIELD :]).rstrip()

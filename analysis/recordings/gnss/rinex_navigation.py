"""Samples from RINEX navigation files.

Galileo's I/NAV records are preferred; F/NAV, whose clock belongs to E1 and E5a, serves satellites
that have no other.
"""

from pathlib import Path

from analysis.samples.sample import EphemerisSample, IonosphereSample, StateVector
from mavproxy_fault.rinex.navigation_record import (
    NavigationRecord,
    kepler_ephemeris,
    read_navigation_file,
)


def read_navigation(path: Path) -> list[EphemerisSample | IonosphereSample]:
    """All usable records of a navigation file in file order, with timestamp 0.

    Raises
    ------
    ConfigError
        If the file is not a RINEX navigation file.
    """
    records, klobuchar = read_navigation_file(path)
    samples: list[EphemerisSample | IonosphereSample] = []
    if klobuchar is not None:
        samples.append(IonosphereSample(0, *klobuchar))
    # Records may be in any order.
    with_inav = {record.satellite for record in records if not record.is_fnav}
    for record in records:
        if not record.is_fnav or record.satellite not in with_inav:
            glonass = record.satellite[0] == "R"
            orbit = _state_vector(record) if glonass else kepler_ephemeris(record)
            samples.append(EphemerisSample(0, orbit))
    return samples


def _state_vector(record: NavigationRecord) -> StateVector:
    """A GLONASS record; its lengths are in km."""
    n, (af0_s, af1, _) = record.numbers, record.clock
    # One line per axis: position, velocity, acceleration; the first line ends with the health.
    r, v, a = ((1000.0 * n[i], 1000.0 * n[i + 4], 1000.0 * n[i + 8]) for i in range(3))
    return StateVector(record.satellite, *record.toc, r, v, a, af0_s, af1, int(n[3]))

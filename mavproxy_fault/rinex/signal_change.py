"""Computes the changes that faults make to satellite signals in a recording.

A spoofed signal is that of another position and time: code, phase and Doppler change consistently.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavproxy_fault.rinex.range_epoch import RangeEpoch, Setting
from mavproxy_fault.wire.plant_names import FASTEST_SPOOF_MPS, INDEXED, SPOOF

Vector = NDArray[np.float64]
# For a timestamp: vector (6,) from the receiver to each satellite, NED [m], and its rate [m/s].
Sky = Callable[[int], Mapping[str, Vector]]

HEALTHY = Setting(0.0, 0.0)
ALL_SYSTEMS = "GEJ"  # the systems that `[all]` stands for


class SignalChange(NamedTuple):
    """Change of the code only [m], of code and phase [m], of the range rate [m/s], loss of C/N0
    [dB], and whether the signal is lost."""

    code_m: float = 0.0
    signal_m: float = 0.0
    rate_mps: float = 0.0
    drop_db: float = 0.0
    lost: bool = False


def signal_changes(
    epoch: RangeEpoch, t_us: int, sky: Sky | None
) -> Iterator[tuple[str, SignalChange]]:
    """Yield each satellite with a changed signal, and the change; `sky` gives the satellites'
    positions for a spoofed receiver position."""
    for name in epoch.satellites:
        of = _settings_of(name, epoch.settings)
        spoof = np.array([of.get(base, HEALTHY) for base in SPOOF])
        signal_m = rate_mps = 0.0
        if spoof.any():
            spoof[np.abs(spoof[:, 1]) > FASTEST_SPOOF_MPS, 1] = 0.0  # a jump has no Doppler
            signal_m, rate_mps = spoof[-1].tolist()
            if spoof[:3].any():
                assert sky is not None
                seen = sky(t_us).get(name)
                # A satellite without an orbit cannot be spoofed to another position.
                moved = (0.0, 0.0) if seen is None else _moved(seen, spoof[:3])
                signal_m, rate_mps = signal_m + moved[0], rate_mps + moved[1]
        change = SignalChange(
            epoch.added_m.get(name, 0.0) + of.get("pseudorange_m", HEALTHY).value,
            signal_m,
            rate_mps + of.get("range_rate_mps", HEALTHY).value,
            of.get("cn0_drop_db", HEALTHY).value,
            name in epoch.lost or of.get("satellite_lost", HEALTHY).value != 0.0,
        )
        if any(change):
            yield name, change


def needs_sky(names: Iterable[str]) -> bool:
    """Whether one of the plant parameters spoofs another position."""
    return any(name.startswith(SPOOF[:3]) for name in names)


def _settings_of(satellite: str, settings: Mapping[str, Setting]) -> dict[str, Setting]:
    """Return the plant parameters of one satellite by name without index."""
    found = {}
    for name, setting in settings.items():
        parts = INDEXED.fullmatch(name)
        assert parts is not None  # by `check_plant_name`
        is_all = parts[2] == "all" and satellite[0] in ALL_SYSTEMS
        if is_all or parts[2] in (satellite[0], satellite):
            found[parts[1]] = setting
    return found


def _moved(seen: Vector, spoof: Vector) -> tuple[float, float]:
    """Return the change of range [m] and range rate [m/s] at the spoofed position; `spoof` (3, 2)
    is its NED offset from the true position, and its velocity."""
    place, motion = seen[:3], seen[3:]
    there, passing = place - spoof[:, 0], motion - spoof[:, 1]
    here_m, there_m = float(np.linalg.norm(place)), float(np.linalg.norm(there))
    rate_mps = float(there @ passing) / there_m - float(place @ motion) / here_m
    return there_m - here_m, rate_mps

"""What faults make of a satellite's signal at the antenna of a recording.

A spoofed signal is that of another place and time: code, phase and Doppler move alike.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mavproxy_fault.rinex.range_epoch import RangeEpoch, Setting
from mavproxy_fault.wire.plant_names import FASTEST_SPOOF_MPS, INDEXED, SPOOF

Vector = NDArray[np.float64]
# At a stamp: (6,) from the receiver to each satellite, north, east and down [m], and its change
# [m/s].
Sky = Callable[[int], Mapping[str, Vector]]

HEALTHY = Setting(0.0, 0.0)
ALL_SYSTEMS = "GEJ"  # the systems that `[all]` stands for


class SignalChange(NamedTuple):
    """Metres on the code alone, metres on code and phase, the range rate's part that goes with
    them, decibels taken away, and whether the signal is lost."""

    code_m: float = 0.0
    signal_m: float = 0.0
    rate_mps: float = 0.0
    drop_db: float = 0.0
    lost: bool = False


def signal_changes(
    epoch: RangeEpoch, t_us: int, sky: Sky | None
) -> Iterator[tuple[str, SignalChange]]:
    """Each satellite of an epoch whose signal is another one, and how; `sky` is asked for those
    that are spoofed to another place."""
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
                # Without an orbit nobody can make its signal up: the spoofer's are all there is.
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
    """Whether one of the plant's parameters pretends another place."""
    return any(name.startswith(SPOOF[:3]) for name in names)


def _settings_of(satellite: str, settings: Mapping[str, Setting]) -> dict[str, Setting]:
    """The plant's parameters of one satellite by their name without the index."""
    found = {}
    for name, setting in settings.items():
        parts = INDEXED.fullmatch(name)
        assert parts is not None  # `check_plant_name` has seen it
        everybody = parts[2] == "all" and satellite[0] in ALL_SYSTEMS
        if everybody or parts[2] in (satellite[0], satellite):
            found[parts[1]] = setting
    return found


def _moved(seen: Vector, spoof: Vector) -> tuple[float, float]:
    """How much longer a range (m) and its rate (m/s) are from the pretended place; `spoof` (3, 2)
    is that place north, east and down of the true one, and its velocity."""
    place, motion = seen[:3], seen[3:]
    there, passing = place - spoof[:, 0], motion - spoof[:, 1]
    here_m, there_m = float(np.linalg.norm(place)), float(np.linalg.norm(there))
    rate_mps = float(there @ passing) / there_m - float(place @ motion) / here_m
    return there_m - here_m, rate_mps

"""Jamming: all satellites' signals fall together; a step of the pipeline that needs no filter.

Each satellite's C/N0 is held against its own mean of the last minute, so that satellites that rise
and set count for nothing. A jammer is noise at the receiver's antenna and takes the same from every
signal of a band; what stands in the way takes more from some than from others, unless it covers the
antenna: a receiver that is packed up is no other to it than one that is jammed. A signal that
vanishes has fallen, too; where most vanish at once, that is told, and not why. Nobody among the
satellites is to blame: the result is about `satellites` as a whole.
"""

import math
from collections.abc import Iterable, Mapping
from typing import ClassVar, NamedTuple

import numpy as np

from analysis.detection.detector_registry import BlockDetector
from analysis.detection.values import Value
from analysis.results import SensorDecision, pattern_alarm
from analysis.samples.block import EPOCH, Block
from analysis.samples.sample import Epoch

LEAST_DB = 6.0  # of the median; an antenna that tilts or a hand near it takes less from all
SPREAD_DB = 3.0  # between the quartiles of the losses: more is something in the way
LEAST_SATELLITES = 5  # of a band
MEAN_S, LEARNED_S = 60.0, 4.0
CONFIRM_EPOCHS = 3  # epochs, and so long, before it is told
CONFIRM_US, REPEAT_US = 300_000, 500_000
USUAL_US = 300_000_000  # after which the weak signals are what it is like now
BAND_HZ = 1e7
LOST_DB = 40.0  # what a signal that vanished has lost at least


class SignalStrength(NamedTuple):
    """Of a satellite: mean C/N0 in dBHz, when it was first and when it was last seen, and the band
    of its carrier."""

    mean_dbhz: float
    began_us: int
    newest_us: int
    band: int = 0

    def updated(self, t_us: int, cn0_dbhz: float) -> "SignalStrength":
        """With one epoch more; a young mean is that of its age."""
        elapsed_us, age_us = t_us - self.newest_us, max(t_us - self.began_us, 1)
        share = min(1.0, elapsed_us / min(MEAN_S * 1e6, age_us))
        mean_dbhz = self.mean_dbhz + share * (cn0_dbhz - self.mean_dbhz)
        return SignalStrength(mean_dbhz, self.began_us, t_us, self.band)


class SignalState(Value, frozen=True):
    """What is known of the satellites' strengths, since when those of some bands have fallen (None:
    they have not) and at how many epochs each, and when that was told last."""

    strengths: dict[str, SignalStrength]
    fallen_since_us: int | None = None
    fallen_epochs: Mapping[int, int] = {}
    reported_us: int | None = None


class JammingDetector(BlockDetector, frozen=True):
    """A step of the pipeline."""

    channels: ClassVar = frozenset({"satellites"})

    def new_state(self) -> SignalState:
        """Nothing came yet."""
        return SignalState({})

    def step(
        self, block: Block, state: SignalState
    ) -> tuple[list[tuple[int, SensorDecision]], SignalState]:
        """Where all signals have fallen, by the row that shows it, and the next state."""
        found = []
        for row in block.rows(EPOCH).tolist():
            epoch = block.beside[row]
            assert isinstance(epoch, Epoch)
            fallen_db, state = _add_epoch(epoch, state)
            if fallen_db:
                found.append((row, _result(epoch.t_us, fallen_db)))
        return found, state


def _add_epoch(epoch: Epoch, state: SignalState) -> tuple[float, SignalState]:
    """By how much all have fallen where that is to be told, else 0, and the next state."""
    t_us, known = epoch.t_us, state.strengths
    now = {
        name: cn0_dbhz
        for name, cn0_dbhz in zip(epoch.satellites, epoch.cn0_dbhz.tolist(), strict=True)
        if math.isfinite(cn0_dbhz)
    }
    since_us = state.fallen_since_us
    epochs = state.fallen_epochs
    fallen = {
        band: common_loss_db(losses, epochs.get(band, 0) >= CONFIRM_EPOCHS)
        for band, losses in _losses(now, known).items()
    }
    fallen_db = max(fallen.values(), default=0.0)
    if not fallen_db or (since_us is not None and t_us - since_us > USUAL_US):
        bands = dict(zip(epoch.satellites, _bands(epoch), strict=True))
        first = {name: SignalStrength(now[name], t_us, t_us, bands[name]) for name in now}
        kept = known if not fallen_db else {}
        return 0.0, SignalState(
            {n: kept[n].updated(t_us, now[n]) if n in kept else first[n] for n in now}
        )
    # The means wait while signals are weak: what they were before is what is asked for.
    since_us = t_us if since_us is None else since_us
    epochs = {band: epochs.get(band, 0) + 1 for band, loss_db in fallen.items() if loss_db}
    lasts = t_us - since_us >= CONFIRM_US and max(epochs.values()) >= CONFIRM_EPOCHS
    if not lasts or (state.reported_us is not None and t_us - state.reported_us < REPEAT_US):
        return 0.0, SignalState(known, since_us, epochs, state.reported_us)
    return fallen_db, SignalState(known, since_us, epochs, t_us)


def _bands(epoch: Epoch) -> list[int]:
    """The band of each satellite's carrier, in whole BAND_HZ: GLONASS's channels are one."""
    if epoch.carrier_hz is None:
        return [0] * len(epoch.satellites)
    return np.rint(epoch.carrier_hz / BAND_HZ).astype(int).tolist()  # type: ignore[no-any-return]


def _losses(now: dict[str, float], known: dict[str, SignalStrength]) -> dict[int, list[float]]:
    """By how much the satellites' signals are weaker than their means, by band; only of those known
    a while."""
    found: dict[int, list[float]] = {}
    for name, strength in known.items():
        if strength.newest_us - strength.began_us >= LEARNED_S * 1e6:
            loss_db = strength.mean_dbhz - now[name] if name in now else LOST_DB
            found.setdefault(strength.band, []).append(loss_db)
    return found


def common_loss_db(losses_db: Iterable[float], already: bool = False) -> float:
    """The median loss where all signals share it, else 0; `already` says that they did before."""
    losses = sorted(losses_db)
    present = [loss for loss in losses if loss < LOST_DB]
    median_db = losses[len(losses) // 2] if len(losses) >= LEAST_SATELLITES else 0.0
    if median_db < LEAST_DB:
        return 0.0
    if already or median_db >= LOST_DB:
        return median_db
    if len(present) < LEAST_SATELLITES:
        return 0.0
    quarter = len(present) // 4
    return median_db if present[-1 - quarter] - present[quarter] <= SPREAD_DB else 0.0


def _result(t_us: int, fallen_db: float) -> SensorDecision:
    weaker = f"jamming, or a covered antenna: all signals are {fallen_db:.0f} dB weaker"
    return pattern_alarm(
        t_us,
        "satellites",
        "most signals are lost" if fallen_db >= LOST_DB else weaker,
    )

"""Detects jamming, a common loss of all satellites' signal strength, without the filter.

Each satellite's C/N0 is compared with its own mean over the last minute, so rising and setting
satellites do not matter (docs/fdi.md, "Jamming"). The result is about all `satellites`.
"""

import math
from collections.abc import Iterable, Mapping
from typing import ClassVar, NamedTuple

import numpy as np

from analysis.detection.detector_registry import REPEAT_US, BlockDetector, RowResults
from analysis.detection.values import Value
from analysis.results import pattern_alarm
from analysis.samples.block import EPOCH, Block
from analysis.samples.sample import Epoch

# Of the median, and between the quartiles of the losses, which an obstruction spreads: no alarm in
# 144 hours under open sky and on the walk (docs/fdi.md, "Jamming").
LEAST_DB, SPREAD_DB = 6.0, 3.0
LEAST_SATELLITES = 5  # of a band: fewer have no quartiles
MEAN_S, LEARNED_S = 60.0, 4.0  # memory of the mean; age of a satellite that counts
CONFIRM_EPOCHS = 3  # in a row: a hand or a wing that passes takes less at 5 Hz
OBSTRUCTED_US = 300_000_000  # after which the weak signals are the new normal
BAND_HZ = 1e7  # wider than the channels of GLONASS, narrower than the distance of bands
LOST_DB = 40.0  # loss of a vanished signal: tracking ends 40 dB below a strong one


class SignalStrength(NamedTuple):
    """Mean C/N0 in dBHz of a satellite, when it was first and last received, and its band."""

    mean_dbhz: float
    began_us: int
    newest_us: int
    band: int = 0

    def updated(self, t_us: int, cn0_dbhz: float) -> "SignalStrength":
        """With one more epoch; the mean of a young one is over its age."""
        elapsed_us, age_us = t_us - self.newest_us, max(t_us - self.began_us, 1)
        share = min(1.0, elapsed_us / min(MEAN_S * 1e6, age_us))
        mean_dbhz = self.mean_dbhz + share * (cn0_dbhz - self.mean_dbhz)
        return SignalStrength(mean_dbhz, self.began_us, t_us, self.band)


class SignalState(Value, frozen=True):
    """The satellites' strengths, since when the signals of some bands are weak (None: they are
    not), at how many epochs of each band, and when that was reported last."""

    strengths: Mapping[str, SignalStrength] = {}
    fallen_since_us: int | None = None
    fallen_epochs: Mapping[int, int] = {}
    reported_us: int | None = None


class JammingDetector(BlockDetector, frozen=True):
    """Tests the median loss of C/N0 in each band."""

    channels: ClassVar = frozenset({"satellites"})
    state: ClassVar = SignalState

    def step(self, block: Block, state: SignalState) -> tuple[RowResults, SignalState]:
        """The alarms of the next samples, each with its row, and the next state."""
        results = []
        for row in block.rows(EPOCH).tolist():
            epoch = block.beside[row]
            assert isinstance(epoch, Epoch)
            fallen_db, state = _add_epoch(epoch, state)
            if fallen_db:
                text = f"jamming, or a covered antenna: all signals are {fallen_db:.0f} dB weaker"
                text = "most signals are lost" if fallen_db >= LOST_DB else text
                results.append((row, pattern_alarm(epoch.t_us, "satellites", text)))
        return results, state


def _add_epoch(epoch: Epoch, state: SignalState) -> tuple[float, SignalState]:
    """The common loss where it is to be reported, else 0, and the next state."""
    t_us, strengths = epoch.t_us, state.strengths
    cn0_now = {
        name: cn0_dbhz
        for name, cn0_dbhz in zip(epoch.satellites, epoch.cn0_dbhz.tolist(), strict=True)
        if math.isfinite(cn0_dbhz)
    }
    since_us, epochs = state.fallen_since_us, state.fallen_epochs
    fallen = {
        band: common_loss_db(losses, epochs.get(band, 0) >= CONFIRM_EPOCHS)
        for band, losses in _losses(cn0_now, strengths).items()
    }
    fallen_db = max(fallen.values(), default=0.0)
    if not fallen_db or (since_us is not None and t_us - since_us > OBSTRUCTED_US):
        bands = dict(zip(epoch.satellites, _bands(epoch), strict=True))
        first = {name: SignalStrength(cn0_now[name], t_us, t_us, bands[name]) for name in cn0_now}
        usual = strengths if not fallen_db else {}
        return 0.0, SignalState(
            {n: usual[n].updated(t_us, cn0_now[n]) if n in usual else first[n] for n in cn0_now}
        )
    # The means are frozen while signals are weak: the loss is relative to the time before.
    since_us = t_us if since_us is None else since_us
    epochs = {band: epochs.get(band, 0) + 1 for band, loss_db in fallen.items() if loss_db}
    lasts = max(epochs.values()) >= CONFIRM_EPOCHS
    if not lasts or (state.reported_us is not None and t_us - state.reported_us < REPEAT_US):
        return 0.0, SignalState(strengths, since_us, epochs, state.reported_us)
    return fallen_db, SignalState(strengths, since_us, epochs, t_us)


def _bands(epoch: Epoch) -> list[int]:
    """The band of each satellite's carrier, in multiples of BAND_HZ: GLONASS's channels are one."""
    if epoch.carrier_hz is None:
        return [0] * len(epoch.satellites)
    return np.rint(epoch.carrier_hz / BAND_HZ).astype(int).tolist()  # type: ignore[no-any-return]


def _losses(
    cn0_now: dict[str, float], strengths: Mapping[str, SignalStrength]
) -> dict[int, list[float]]:
    """The satellites' losses relative to their means, by band; only of those known for a while."""
    results: dict[int, list[float]] = {}
    for name, strength in strengths.items():
        if strength.newest_us - strength.began_us >= LEARNED_S * 1e6:
            loss_db = strength.mean_dbhz - cn0_now[name] if name in cn0_now else LOST_DB
            results.setdefault(strength.band, []).append(loss_db)
    return results


def common_loss_db(losses_db: Iterable[float], sustained: bool = False) -> float:
    """Return the median loss if all signals share it, else 0; `sustained`: they did before, too."""
    losses = sorted(losses_db)
    present = [loss for loss in losses if loss < LOST_DB]
    median_db = losses[len(losses) // 2] if len(losses) >= LEAST_SATELLITES else 0.0
    if median_db < LEAST_DB:
        return 0.0
    if sustained or median_db >= LOST_DB:
        return median_db
    if len(present) < LEAST_SATELLITES:
        return 0.0
    quarter = len(present) // 4
    return median_db if present[-1 - quarter] - present[quarter] <= SPREAD_DB else 0.0

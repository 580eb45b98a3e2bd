"""Observe: the usable measurements of an epoch, with an ephemeris for each satellite."""

from analysis.detection.filter.ephemerides import BroadcastData, select_ephemerides
from analysis.detection.filter.filter_config import FilterConfig
from analysis.detection.filter.measurement import EpochObservation, observe_epoch
from analysis.detection.filter.two_frequencies import ionosphere_free
from analysis.samples.sample import Epoch


def observe(
    epoch: Epoch, broadcast: BroadcastData, config: FilterConfig
) -> tuple[EpochObservation | None, BroadcastData]:
    """The observation (None: no satellite is usable), and the broadcast data with its selection."""
    if config.ionosphere_free:
        epoch = ionosphere_free(epoch)
    selection, wrong = broadcast.selection, broadcast.wrong
    if selection is None or not selection.is_valid_for(epoch):
        selection = select_ephemerides(epoch, broadcast.ephemerides, config.systems, wrong)
        wrong = wrong.union(selection.contradicted)
        broadcast = broadcast._replace(selection=selection, wrong=wrong)
    return observe_epoch(epoch, selection), broadcast

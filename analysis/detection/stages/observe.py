"""Observe: the usable measurements of an epoch, with an ephemeris for each satellite."""

from analysis.detection.filter.ephemerides import BroadcastData, select_ephemerides
from analysis.detection.filter.measurement import EpochObservation, observe_epoch
from analysis.samples.sample import Epoch


def observe(
    epoch: Epoch, broadcast: BroadcastData, systems: str
) -> tuple[EpochObservation | None, BroadcastData]:
    """The observation (None: no satellite is usable), and the broadcast data with its selection.

    `systems` are the first letters of the systems in use.
    """
    selection = broadcast.selection
    if selection is None or not selection.is_valid_for(epoch):
        selection = select_ephemerides(epoch, broadcast.ephemerides, systems, broadcast.wrong)
        wrong = broadcast.wrong.union(selection.contradicted)
        broadcast = broadcast._replace(selection=selection, wrong=wrong)
    return observe_epoch(epoch, selection), broadcast

"""Parameters of the detector: those of its filter and of isolation, and how far it looks back."""

from analysis.detection.filter.filter_config import Seconds
from analysis.detection.isolation.isolation_config import IsolationConfig


class DetectorConfig(IsolationConfig, frozen=True, kw_only=True, dict=True):
    """Every parameter of the detector; each is defined beside the code it configures.

    `reset_s` is the longest gap of epochs that the filter bridges, `history_s` how far back the
    filter can be repaired.
    """

    reset_s: Seconds = 10.0
    history_s: Seconds = 30.0

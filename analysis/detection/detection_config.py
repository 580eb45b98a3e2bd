"""Parameters of the detector: its filter, fault isolation, and how far it looks back."""

from typing import Annotated, Literal

from msgspec import Meta

from analysis.detection.filter.filter_config import FilterConfig, Seconds
from mavproxy_fault.documents.document_check import NotNegative

MOST_LEFT_OUT = 64  # satellites: more than are ever in view


class DetectorConfig(FilterConfig, frozen=True, kw_only=True, dict=True):
    """Every parameter of the detector: the filter's, the faults that may be isolated, and how long
    a faulty source is not used.

    `rule` is how a verdict is found, `left_out` the most satellites left out for it. An excluded
    satellite must look healthy for `readmit_s` before it is used again; a faulty IMU is not used
    for `imu_hold_s`. `slow_accel_mps2` is the error that a healthy IMU's acceleration may have
    for seconds. `reset_s` is the longest gap of epochs that the filter bridges, `history_s` how far
    back the filter can be repaired.
    """

    rule: Literal["explicit", "plain"] = "explicit"
    left_out: Annotated[int, Meta(ge=0, le=MOST_LEFT_OUT)] = 3
    readmit_s: Seconds = 10.0
    imu_hold_s: Seconds = 10.0
    slow_accel_mps2: NotNegative = 0.1
    reset_s: Seconds = 10.0
    history_s: Seconds = 30.0

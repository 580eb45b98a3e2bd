"""Parameters of the fusion."""

from typing import Literal

import msgspec

from mavproxy_fault.documents.document_check import Positive


class FusionConfig(msgspec.Struct, frozen=True, kw_only=True):
    """Weights, noise and window of the smoother.

    `lag_s` is the length of the smoothed window. A normalised residual below `suspicious` has
    weight 1, above `hopeless` weight 0. With `feedback` the detector continues from the fused
    state; with `compare` a second graph uses all measurements without exclusions, to show the
    effect of isolation. `decide` False uses all measurements without exclusions, and `robust` is
    one of GTSAM's losses on the pseudoranges (or its graduated non-convexity): both for comparison.
    Pseudorange errors last for seconds to minutes while the graph takes every measurement as
    independent: `correlation` multiplies their sigmas, and a bias of `slow` sigmas per satellite is
    added to the reported covariance of position. With `learn` that share, the rates' sigmas and the
    IMU's noise are estimated in flight. The other sigmas are per GNSS epoch, random walks per
    square root of a second.
    """

    lag_s: Positive = 5.0
    suspicious: Positive = 3.0
    hopeless: Positive = 6.0
    feedback: bool = False
    compare: bool = False
    decide: bool = True
    robust: Literal["none", "huber", "geman-mcclure", "gnc"] = "none"
    correlation: Positive = 3.0
    slow: Positive = 0.4
    learn: bool = True
    baro_m: Positive = 1.0
    baro_walk_m: Positive = 0.3
    mag_gauss: Positive = 0.1
    airspeed_mps: Positive = 1.0
    wind_walk_mps: Positive = 0.3
    vision_m: Positive = 0.2
    vision_rad: Positive = 0.02
    gps_mps: Positive = 0.4

    def __post_init__(self) -> None:
        if not self.suspicious < self.hopeless:
            raise ValueError(
                f"hopeless = {self.hopeless} is not above suspicious = "
                f"{self.suspicious}; give a larger number"
            )

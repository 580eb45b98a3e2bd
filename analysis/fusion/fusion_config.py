"""Parameters of the fusion."""

import msgspec

ROBUST = ("none", "huber", "geman-mcclure", "gnc")


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

    lag_s: float = 5.0
    suspicious: float = 3.0
    hopeless: float = 6.0
    feedback: bool = False
    compare: bool = False
    decide: bool = True
    robust: str = "none"
    correlation: float = 3.0
    slow: float = 0.4
    learn: bool = True
    baro_m: float = 1.0
    baro_walk_m: float = 0.3
    mag_gauss: float = 0.1
    airspeed_mps: float = 1.0
    wind_walk_mps: float = 0.3
    vision_m: float = 0.2
    vision_rad: float = 0.02
    gps_mps: float = 0.4

    def __post_init__(self) -> None:
        """Check the ranges of the values.

        Raises
        ------
        ValueError
            Naming the field, its value and what is allowed.
        """
        for name in self.__struct_fields__:
            value = getattr(self, name)
            # Written so that NaN is refused too.
            if isinstance(value, float) and not value > 0.0:
                raise ValueError(f"{name} = {value} is not positive; give a number above 0")
        if not self.suspicious < self.hopeless:
            raise ValueError(
                f"hopeless = {self.hopeless} is not above suspicious = "
                f"{self.suspicious}; give a larger number"
            )
        if self.robust not in ROBUST:
            raise ValueError(f"robust = {self.robust!r} is unknown; known: {', '.join(ROBUST)}")

"""The `gnss` section of a scenario: satellites, errors and receiver.

Every error can be switched off; without errors, pseudoranges contain geometry and the satellites'
broadcast clocks only.
"""

import math
from datetime import datetime
from typing import Annotated, Literal

from msgspec import Meta

from mavproxy_fault.documents.document_check import NotNegative, Section


class ClockConfig(Section, frozen=True):
    """The receiver's clock: two states driven by white noise.

    `offset_s` and `drift` are the standard deviations of the initial values. `h0_s` and `h2_hz` are
    the Allan coefficients h_0 and h_-2 of its frequency; the defaults are those of a
    temperature-compensated crystal (Brown and Hwang, Introduction to Random Signals and Applied
    Kalman Filtering, 4th ed., table 9.2). Galileo pseudoranges are `galileo_offset_m` longer than
    GPS's (inter-system bias).
    """

    offset_s: NotNegative = 1e-6
    drift: NotNegative = 1e-7
    h0_s: NotNegative = 2e-19
    h2_hz: NotNegative = 2e-20
    galileo_offset_m: float = 1.5


class ReceiverConfig(Section, frozen=True):
    """How the receiver acquires and loses satellites.

    After a `hot` start the receiver has all ephemerides and tracks every signal at power-on. After
    a `cold` start it acquires a satellite after a time with mean `search_s` (exponential) and uses
    it for the fix once its ephemeris is read, `message_s[0]` to `message_s[1]` later (uniform; GPS
    repeats its subframes 1 to 3 every 30 s). A signal below `lock_dbhz` is lost, and reacquired
    `reacquire_s` after it returns.
    """

    start: Literal["hot", "cold"] = "hot"
    search_s: NotNegative = 5.0
    message_s: tuple[float, float] = (18.0, 36.0)
    lock_dbhz: NotNegative = 25.0
    reacquire_s: NotNegative = 2.0

    def __post_init__(self) -> None:
        first, last = self.message_s
        if not 0.0 <= first <= last < math.inf:
            raise ValueError(
                f"message_s = {list(self.message_s)} is not a range; give two numbers of seconds, "
                "0 or more, the first not above the second"
            )


class GnssConfig(Section, frozen=True):
    """Satellites and errors of the measurements.

    Parameters
    ----------
    navigation : str, optional
        A RINEX 3 navigation file; by default the shipped constellation, rotated over the home.
    time : datetime, optional
        GPS time at the simulation's start, without a zone; by default 2021-03-19T12:00:00 with the
        shipped file, or when most satellites of another file are valid.
    mask_deg : float
        Satellites below this elevation are not tracked.
    cn0_zenith_dbhz, cn0_horizon_dbhz, cn0_sigma_db : float
        C/N0 is linear in the sine of the elevation, plus a Gauss-Markov process (20 s).
    thermal : float
        Scale of the code and Doppler noise that follows from C/N0 (0: none, 1: as modelled).
    multipath, multipath_s : float
        Scale and correlation time of multipath, 0.13 m + 0.53 m exp(-elevation/10 deg).
    orbit_m, orbit_s : float
        Standard deviation and correlation time of the broadcast orbit and clock error.
    """

    rate_hz: Annotated[float, Meta(gt=0, le=100)] = 5.0  # epochs per second
    latency_s: NotNegative = 0.0
    id: Annotated[int, Meta(ge=0)] = 0
    navigation: str | None = None
    time: datetime | None = None
    systems: tuple[Literal["GPS", "Galileo"], ...] = ("GPS", "Galileo")
    mask_deg: Annotated[float, Meta(ge=0, le=90)] = 10.0
    ionosphere: bool = True
    troposphere: bool = True
    cn0_zenith_dbhz: NotNegative = 49.5
    cn0_horizon_dbhz: NotNegative = 32.0
    cn0_sigma_db: NotNegative = 0.5
    thermal: NotNegative = 1.0
    multipath: NotNegative = 1.0
    multipath_s: NotNegative = 20.0
    orbit_m: NotNegative = 0.4
    orbit_s: NotNegative = 1800.0
    clock: ClockConfig = ClockConfig()
    receiver: ReceiverConfig = ReceiverConfig()

    def __post_init__(self) -> None:
        if not self.systems:
            raise ValueError("systems is empty; list GPS, Galileo or both")

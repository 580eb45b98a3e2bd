"""The GNSS sensor: signals with errors, the receiver that tracks them, and its readings."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import msgspec
import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.numerics.arrays import Array
from mavproxy_fault.rinex.gps_clock import normalized
from mavproxy_fault.rtcm.ephemeris_messages import encode_ephemeris
from mavproxy_fault.wire.plant_names import GROUPS, SATELLITE, SPOOF
from simvehicle.gnss.constellation import Constellation
from simvehicle.gnss.gnss_config import GnssConfig
from simvehicle.gnss.pseudorange import NO_COEFFICIENTS, Atmosphere
from simvehicle.gnss.receiver import NO_FIX, ReceiverFix, solve_receiver_fix
from simvehicle.gnss.satellite_orbits import Orbits, select_orbits, tabulate_orbits
from simvehicle.gnss.signal_errors import (
    CN0_CORRELATION_S,
    ReceiverClock,
    step_clock,
    step_gauss_markov,
)
from simvehicle.gnss.signal_kernel import CODE, RATE, SignalChannel, simulate_signals
from simvehicle.gnss.spoofing import DELAY, spoofed_places
from simvehicle.gnss.tracking import (
    LONG_AGO_US,
    Stamps,
    Tracking,
    powered_off_tracking,
    update_tracking,
)
from simvehicle.sensors.readings import EphemerisReading, GpsReading, PseudorangeReading, Reading
from simvehicle.vehicles.body import Truth

S_PER_US = 1e-6
BROADCAST_US = 30_000_000  # interval at which an ephemeris is repeated, as in the GPS message
LOST_ROW = 2  # the row of `SignalFaults.signals`, which are in the order of `SATELLITE`
PLANT_NAME = re.compile(rf"({'|'.join((*SATELLITE, *SPOOF))})\[([GE]\d\d|all|G|E)\]")


class SignalFaults(msgspec.Struct, frozen=True):
    """Plant faults of the signals and of the receiver.

    The rows of `signals` (4, n) are metres added to the range, decibels taken off C/N0, signal loss
    (not 0), and m/s added to the range rate. The rows of `spoof` (4, n) are the spoofed position's
    offset north, east and down and the spoofed delay [m]. `off` is not 0 while the receiver is off.
    """

    signals: Array
    spoof: Array
    off: float = 0.0


class Broadcast(msgspec.Struct, frozen=True):
    """The ephemerides in use: their indices, which satellites have one, and their orbits.

    The choice is valid up to and including `until_s` (seconds of the constellation's week).
    """

    chosen: tuple[int | None, ...]
    valid: NDArray[np.bool_]
    orbits: Orbits
    until_s: float


class GnssState(msgspec.Struct, frozen=True):
    """State of `GnssSensor`; arrays (n,) have one entry per satellite of its constellation.

    The rows of `wander` (3, n) are the unit-variance Gauss-Markov processes of multipath, orbit and
    C/N0. `search_s`, `message_s` are the acquisition and ephemeris times of a cold start. `sent_us`
    is when each ephemeris was last sent, `last_spoof` (4, n) the `spoof` of the last epoch.
    """

    t_us: int | None
    clock: ReceiverClock
    wander: Array
    search_s: Array
    message_s: Array
    broadcast: Broadcast
    tracking: Tracking
    sent_us: Stamps
    faults: SignalFaults
    last_spoof: Array
    fix: ReceiverFix = NO_FIX


@dataclass(frozen=True)
class GnssSensor:
    """Pseudoranges, ephemerides and the receiver's solution of one antenna."""

    config: GnssConfig
    constellation: Constellation

    @property
    def rate_hz(self) -> float:
        """Epochs per second."""
        return self.config.rate_hz

    @property
    def latency_s(self) -> float:
        """From measurement to delivery."""
        return self.config.latency_s

    @cached_property
    def _atmosphere(self) -> Atmosphere:
        klobuchar = np.array(self.constellation.klobuchar)
        coefficients = klobuchar if self.config.ionosphere else NO_COEFFICIENTS
        return Atmosphere(coefficients, self.config.troposphere)

    @cached_property
    def _unsent(self) -> Stamps:
        return np.full(len(self.constellation.satellites), LONG_AGO_US)

    @cached_property
    def _channel(self) -> SignalChannel:
        c, galileo = self.config, [name[0] == "E" for name in self.constellation.satellites]
        rise = c.cn0_zenith_dbhz - c.cn0_horizon_dbhz
        sizes = c.thermal, c.multipath, c.orbit_m, c.clock.galileo_offset_m
        levels = np.array([c.cn0_horizon_dbhz, rise, c.cn0_sigma_db, *sizes])
        return SignalChannel(*self._atmosphere, levels, np.array(galileo, dtype=float))

    def new_state(self, rng: np.random.Generator) -> GnssState:
        """The state at power-on."""
        clock, receiver = self.config.clock, self.config.receiver
        n = len(self.constellation.satellites)
        drawn = rng.standard_normal((3, n))
        return GnssState(
            t_us=None,
            clock=ReceiverClock(
                clock.offset_s * float(rng.standard_normal()),
                clock.drift * float(rng.standard_normal()),
            ),
            wander=drawn,
            # Drawn for a hot start, too, so that the later draws do not depend on the start.
            search_s=receiver.search_s * rng.standard_exponential(n),
            message_s=rng.uniform(*receiver.message_s, n),
            broadcast=self._broadcast(self.constellation.start_s, [None] * n),
            tracking=powered_off_tracking(n, cold=receiver.start == "cold"),
            sent_us=self._unsent,
            faults=SignalFaults(np.zeros((len(SATELLITE), n)), np.zeros((len(SPOOF), n))),
            last_spoof=np.zeros((4, n)),
        )

    def sample(
        self, truth: Truth, state: GnssState, rng: np.random.Generator
    ) -> tuple[list[Reading], GnssState]:
        """The readings of one epoch: pseudoranges, the fix, and ephemerides that are due.

        The receiver samples when its own clock shows `truth.t_us` after the start, so it measures
        at the true position displaced by the clock offset.
        """
        t_us = truth.t_us
        step_s = 0.0 if state.t_us is None else (t_us - state.t_us) * S_PER_US
        state = self._advanced(state, t_us, rng)
        count = len(self.constellation.satellites)
        # Drawn for every satellite, even with the receiver off: the fault-free reference flight
        # then has the same noise.
        noise = rng.standard_normal((2, count))
        if state.faults.off:
            off = powered_off_tracking(count, cold=True)
            return [], replace(state, tracking=off, fix=NO_FIX, sent_us=self._unsent)
        tow_s = self.constellation.start_s + t_us * S_PER_US
        elevation, cn0, code, rate = self._signals(truth, tow_s, state, noise, step_s)
        tracking = self._tracking(elevation, cn0, state, t_us)
        usable = np.flatnonzero(tracking.usable(t_us))
        orbits = select_orbits(state.broadcast.orbits, usable)
        fix = solve_receiver_fix(
            orbits, tow_s, code[usable], rate[usable], self._atmosphere, state.fix
        )
        due = self._due(usable, state.sent_us, t_us)
        sent_us = state.sent_us.copy()
        sent_us[due] = t_us
        tracked = np.flatnonzero(tracking.tracked(t_us))
        readings: list[Reading] = [
            *(self._ephemeris(t_us, k, state) for k in due),
            self._pseudoranges(t_us, tow_s, tracked, code, rate, cn0),
            self._position(truth, fix),
        ]
        spoofed = state.faults.spoof
        return readings, replace(
            state, tracking=tracking, sent_us=sent_us, fix=fix, last_spoof=spoofed
        )

    def with_plant(self, state: GnssState, name: str, value: float | None) -> GnssState:
        """The state with one plant fault set on the signals; None removes the fault.

        `pseudorange_m[G12]` adds to the range, `cn0_drop_db[G12]` weakens the signal,
        `satellite_lost[G12]` removes it if not 0, `range_rate_mps[G12]` adds to the Doppler only.
        `spoof_north_m[G12]` (and east, down) makes it the signal received at another position, code
        and Doppler alike, `spoof_clock_m[G12]` at another time. `[all]` selects every satellite,
        `[G]` and `[E]` those of a system. `receiver_off` switches the receiver off if not 0;
        removing it causes a cold start.

        Raises
        ------
        ConfigError
            If there is no such fault or satellite.
        """
        number = 0.0 if value is None else value
        faults = state.faults
        if name == "receiver_off":
            return replace(state, faults=replace(faults, off=number))
        match = PLANT_NAME.fullmatch(name)
        names = self.constellation.satellites
        if match is None or (match[2] not in GROUPS and match[2] not in names):
            raise ConfigError(
                f"plant: {name!r} is unknown; use receiver_off, or "
                f"{', '.join((*SATELLITE, *SPOOF))} with one of [{'], ['.join((*GROUPS, *names))}]"
            )
        mask = np.array([match[2] in ("all", satellite[0], satellite) for satellite in names])
        rows, field = (SATELLITE, "signals") if match[1] in SATELLITE else (SPOOF, "spoof")
        changed = getattr(faults, field).copy()
        changed[rows.index(match[1]), mask] = number
        return replace(state, faults=replace(faults, **{field: changed}))

    def _signals(
        self, truth: Truth, tow_s: float, state: GnssState, noise: Array, step_s: float
    ) -> Array:
        """The signals at the antenna when the receiver's clock shows `tow_s`, as rows (4, n).

        A spoofed signal is replaced by that of the spoofed position and time.
        """
        here = np.array([truth.lat_rad, truth.lon_rad, truth.height_m, *truth.v_ned_mps.tolist()])
        out = self._received(here, tow_s, state, noise)
        if state.faults.spoof.any():
            for spoof in spoofed_places(state.faults.spoof, state.last_spoof, step_s):
                # The same clock and noise, as the receiver is the same: only the geometry changes.
                spoofed, own = self._received(spoof.position(here), tow_s, state, noise), spoof.mask
                out[CODE, own] = spoofed[CODE, own] + spoof.offset_m[DELAY]
                out[RATE, own] = spoofed[RATE, own] + spoof.offset_mps[DELAY]
        return out

    def _received(self, where: Array, tow_s: float, state: GnssState, noise: Array) -> Array:
        """The signals at a position: latitude, longitude, height and velocity NED (6,)."""
        return simulate_signals(
            state.broadcast.orbits.table,
            tow_s,
            where,
            (state.clock.offset_s, state.clock.drift),
            self._channel,
            state.wander,
            state.faults.signals,
            noise,
        )

    def _broadcast(self, tow_s: float, present: Sequence[int | None]) -> Broadcast:
        """The ephemerides in use; a satellite without a valid one is placed by its first."""
        constellation = self.constellation
        chosen = constellation.choose_ephemerides(tow_s, present)
        sets = zip(constellation.ephemerides, chosen, strict=True)
        return Broadcast(
            chosen,
            np.array([k is not None for k in chosen]),
            tabulate_orbits([options[k or 0] for options, k in sets], constellation.week),
            constellation.valid_until_s(tow_s, chosen),
        )

    def _advanced(self, state: GnssState, t_us: int, rng: np.random.Generator) -> GnssState:
        """The state with clock, error processes and choice of ephemerides at `t_us`."""
        config = self.config
        n = len(self.constellation.satellites)
        draws = rng.standard_normal(3 * n + 2)
        tow_s = self.constellation.start_s + t_us * S_PER_US
        # Choosing searches all ephemerides, so it is done only when the result may change.
        if tow_s > state.broadcast.until_s:
            old = state.broadcast
            new = self._broadcast(tow_s, old.chosen)
            renewed = [a != b for a, b in zip(new.chosen, old.chosen, strict=True)]
            sent_us = np.where(renewed, LONG_AGO_US, state.sent_us)
            state = replace(state, broadcast=new, sent_us=sent_us)
        if state.t_us is None:
            return replace(state, t_us=t_us)
        step_s = (t_us - state.t_us) * S_PER_US
        # Of multipath, orbit and C/N0.
        lasts_s = np.array([[config.multipath_s], [config.orbit_s], [CN0_CORRELATION_S]])
        return replace(
            state,
            t_us=t_us,
            clock=step_clock(state.clock, config.clock, step_s, draws[:2]),
            wander=step_gauss_markov(state.wander, lasts_s, step_s, draws[2:].reshape(3, n)),
        )

    def _tracking(
        self, elevation_rad: Array, cn0_dbhz: Array, state: GnssState, t_us: int
    ) -> Tracking:
        """The receiver's tracking of the signals above the elevation mask and C/N0 threshold."""
        receiver = self.config.receiver
        signal = (
            (elevation_rad >= math.radians(self.config.mask_deg))
            & (cn0_dbhz >= receiver.lock_dbhz)
            & (state.faults.signals[LOST_ROW] == 0.0)
            & state.broadcast.valid
        )
        return update_tracking(
            state.tracking, signal, t_us, receiver, state.search_s, state.message_s
        )

    def _due(self, usable: NDArray[np.intp], sent_us: Stamps, t_us: int) -> list[int]:
        """Satellites whose ephemeris is new, or else the one sent longest ago, if due."""
        new = [int(k) for k in usable if sent_us[k] == LONG_AGO_US]
        if new or not len(usable):
            return new
        oldest = int(usable[np.argmin(sent_us[usable])])
        return [oldest] if t_us - sent_us[oldest] >= BROADCAST_US else []

    def _ephemeris(self, t_us: int, satellite: int, state: GnssState) -> EphemerisReading:
        ephemeris = self.constellation.ephemerides[satellite][
            state.broadcast.chosen[satellite] or 0
        ]
        return EphemerisReading(t_us, ephemeris.satellite, encode_ephemeris(ephemeris))

    def _pseudoranges(
        self,
        t_us: int,
        tow_s: float,
        pick: NDArray[np.intp],
        code: Array,
        rate: Array,
        cn0: Array,
    ) -> PseudorangeReading:
        return PseudorangeReading(
            t_us,
            # Internally seconds continue beyond the week's end; a receiver's roll over.
            *normalized(self.constellation.week, tow_s),
            tuple(self.constellation.satellites[k] for k in pick),
            code[pick],
            rate[pick],
            cn0[pick],
        )

    def _position(self, truth: Truth, fix: ReceiverFix) -> GpsReading:
        """The fix as a receiver reports it; the geoid undulation is assumed known."""
        known = bool(fix.r_ecef_m.any())
        undulation_m = truth.height_m - truth.alt_msl_m
        north, east, down = fix.sigma_ned_m
        return GpsReading(
            truth.t_us,
            math.degrees(fix.lat_rad),
            math.degrees(fix.lon_rad),
            fix.height_m - undulation_m if known else 0.0,
            tuple(fix.v_ned_mps.tolist()),
            fix.fix_type,
            fix.satellites,
            math.hypot(north, east),
            float(down),
            self.config.id,
        )

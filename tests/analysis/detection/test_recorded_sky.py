"""Spoofs of a recording: the receiver stands where the spoofer says, by code and by Doppler."""

import numpy as np
import pytest

from analysis.detection.recorded_sky import locate_receiver, orbits_of
from analysis.recordings.read_recordings import read_rinex
from analysis.samples.sample import Epoch
from mavproxy_fault.app.replaying.rinex_faults import faulted_lines
from mavproxy_fault.numerics.earth_kernel import geodetic_position, ned_axes
from mavproxy_fault.schedule.entries import parse_schedule

CARRY_OFF = {"preset": "gnss-carry-off", "at_s": 10, "for_s": 60}  # north, 5 m/s to 200 m


def epochs(observations, navigation, lines=None):
    block = read_rinex(observations, navigation, lines=lines)
    return [s for s in block.samples() if isinstance(s, Epoch)], orbits_of(block)


def clean_and_spoofed(observations, navigation):
    """All epochs without and with the carry-off, and the orbits."""
    lines, _ = faulted_lines(observations, parse_schedule({"faults": [CARRY_OFF]}), [navigation])
    clean, orbits = epochs(observations, navigation)
    return clean, epochs(observations, navigation, lines)[0], orbits


def test_the_receiver_is_carried_off_as_the_preset_says(shared_data):
    static = shared_data / "gnss_static"
    clean, spoofed, orbits = clean_and_spoofed(static / "SEPT078M.21O", static / "SEPT078M.21P")
    both = [
        (locate_receiver(a.select(own), orbits), locate_receiver(b.select(own), orbits))
        for a, b in zip(clean, spoofed, strict=True)
        for own in [[i for i, name in enumerate(a.satellites) if name[0] in "GE"]]
    ]
    here, there = (np.array(side) for side in zip(*both, strict=True))
    lat, lon, _ = geodetic_position(here[0])
    moved_m = (there - here) @ ned_axes(lat, lon).T
    wanted_m = np.zeros_like(moved_m)
    wanted_m[10:50, 0], wanted_m[50:70, 0] = 5.0 * np.arange(40), 200.0
    # Half a millimetre of rounding on each range, times a dilution of a few; and the troposphere of
    # a place so much further.
    assert moved_m == pytest.approx(wanted_m, abs=0.1)


def test_code_and_doppler_of_a_spoofed_signal_agree(shared_data):
    walk = shared_data / "gnss_imu_walk"
    clean, spoofed, _ = clean_and_spoofed(walk / "walk_ex.obs", walk / "walk_ex.nav")
    compared = 0
    for old, new, before, after in zip(clean, clean[1:], spoofed, spoofed[1:], strict=False):
        since_s = (old.t_us - clean[0].t_us) * 1e-6
        if old.satellites != new.satellites or not 10.5 < since_s < 45.0:
            continue
        grown = (after.pseudorange_m - new.pseudorange_m) - (
            before.pseudorange_m - old.pseudorange_m
        )
        rates = after.doppler_mps - new.doppler_mps
        known = np.isfinite(rates)
        step_s = (new.t_us - old.t_us) * 1e-6
        # Two ranges rounded to a millimetre each, over the step.
        assert rates[known] == pytest.approx(grown[known] / step_s, abs=0.004 / step_s)
        assert np.abs(rates[known]).max() > 1.0
        compared += int(known.sum())
    assert compared > 500

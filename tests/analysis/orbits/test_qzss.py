"""QZSS: real pseudoranges fit those of GPS with one clock; its health covers more than L1."""

import math
from pathlib import Path

import numpy as np
import pytest

from analysis.detection import Detector, DetectorConfig
from analysis.detection.detector import run_detector
from analysis.orbits.broadcast import (
    CLOCK_OF,
    CLOCKS,
    ELEVATION,
    RANGE,
    RATE,
    SYSTEMS,
    pack_ephemeris,
    predict_ranges,
    satellite_states,
)
from analysis.recordings.gnss.rinex_navigation import read_navigation
from analysis.recordings.gnss.ubx_log import read_ubx
from analysis.recordings.read_recordings import read_rinex_samples
from analysis.results import Decision
from analysis.samples.sample import EphemerisSample, Epoch, IonosphereSample
from mavproxy_fault.numerics.constants import GPS_GM_M3PS2
from mavproxy_fault.numerics.earth import ecef_from_geodetic
from mavproxy_fault.rtcm.ephemeris_messages import Ephemeris, l1_health
from tests.analysis.recordings.gnss.ubx_encoding import broadcast, rawx

TESTS = Path(__file__).parents[2]
FOLDER, RTKLIB = TESTS / "data/gnss_qzss", TESTS / "authorities/rtklib_qzss"
ANTENNA = np.asarray(
    ecef_from_geodetic(math.radians(35.134707705), math.radians(136.977577939), 104.853)
)
LOWEST_RAD = math.radians(15.0)


def recorded() -> list:
    return read_rinex_samples(FOLDER / "base.obs", FOLDER / "base.nav")


def left_over(samples: list, system: str) -> np.ndarray:
    """Ranges (m) and rates (m/s) of one system above 15 degrees at the known place, less what is
    common to GPS's."""
    orbits = {
        s.ephemeris.satellite: pack_ephemeris(s.ephemeris)
        for s in samples
        if isinstance(s, EphemerisSample)
    }
    ionosphere = np.array(
        next(s.alpha + s.beta for s in samples if isinstance(s, IonosphereSample))
    )
    rows = []
    for epoch in (s for s in samples if isinstance(s, Epoch)):
        packed = np.array([orbits[name] for name in epoch.satellites])
        states = satellite_states(packed, epoch.week, epoch.tow_s, epoch.pseudorange_m)
        predicted = predict_ranges(states, ANTENNA, np.zeros(3), epoch.tow_s, ionosphere)
        left = np.column_stack(
            [
                epoch.pseudorange_m - predicted[:, RANGE],
                epoch.doppler_mps - predicted[:, RATE],
            ]
        )
        above = predicted[:, ELEVATION] > LOWEST_RAD
        of = np.array([name[0] for name in epoch.satellites])
        left -= np.median(left[above & (of == "G")], axis=0)
        rows.append(left[above & (of == system)])
    return np.concatenate(rows)


def test_real_ranges_and_rates_of_qzss_fit_those_of_gps_on_one_clock():
    samples = recorded()
    gps, qzss = left_over(samples, "G"), left_over(samples, "J")
    assert len(qzss) == 20
    # Orbit, clock and ionosphere of a satellite: GPS's own are up to 2.9 m there.
    assert np.abs(qzss[:, 0]).max() < 1.5 < np.abs(gps[:, 0]).max()
    assert abs(np.median(qzss[:, 0])) < 0.5
    assert abs(np.median(qzss[:, 1])) < 0.02
    assert qzss[:, 1].std() < 0.05


def test_a_detector_takes_qzss_without_another_clock():
    found = run_detector(Detector(DetectorConfig(systems="GJ")), recorded())
    decisions = [d for d in found if isinstance(d, Decision)]
    last = decisions[-1]
    assert {name for name in last.satellites if name[0] == "J"} == {"J03", "J07"}
    assert last.parity_dof == len(last.satellites) - 4
    assert not any(d.alarm for d in decisions)


def test_a_real_u_blox_log_brings_qzss_with_the_orbits_that_rtklib_finds_in_it():
    epochs, sent = read_ubx(FOLDER / "f9p.ubx")
    assert all({"J02", "J03", "J04", "J07"} <= set(epoch.satellites) for epoch in epochs)
    assert len(epochs) == 5
    theirs = {
        s.ephemeris.satellite: s.ephemeris
        for s in read_navigation(RTKLIB / "orbits.nav")
        if isinstance(s, EphemerisSample)
    }
    ours = {s.ephemeris.satellite: s.ephemeris for s in sent if isinstance(s, EphemerisSample)}
    assert {name[0] for name in theirs} == {"G", "J"}
    assert set(ours) == set(theirs)
    for name, wanted in theirs.items():
        packed = pack_ephemeris(ours[name]), pack_ephemeris(wanted)
        np.testing.assert_allclose(*packed, rtol=1e-11, atol=1e-16, err_msg=name)


def test_four_satellites_of_qzss_move_a_position_by_gps_by_a_metre():
    samples = read_rinex_samples(FOLDER / "f9p.ubx", [])
    with_qzss, without = (
        [d for d in run_detector(Detector(DetectorConfig(systems=systems)), samples)
         if isinstance(d, Decision)][-1]
        for systems in ("GJ", "G")
    )  # fmt: skip
    assert (with_qzss.parity_dof, without.parity_dof) == (13 - 4, 9 - 4)
    assert not with_qzss.alarm
    assert with_qzss.position_ecef_m is not None
    assert without.position_ecef_m is not None
    # Orbits, clocks and the ionosphere leave GPS alone 2 m of sigma there.
    assert math.dist(with_qzss.position_ecef_m, without.position_ecef_m) < 2.0


def test_every_system_has_a_clock():
    assert list(CLOCK_OF) == list(SYSTEMS)
    assert set(CLOCK_OF.values()) == set(range(CLOCKS))
    assert CLOCK_OF["J"] == CLOCK_OF["G"]


@pytest.mark.parametrize(
    ("satellite", "bits", "healthy"),
    [
        ("J02", 0b000001, True),  # C/A is sent, C/B is not
        ("J04", 0b010000, True),  # C/B is sent, C/A is not
        ("J02", 0b001111, True),  # L2C, L5 and L1C out of order
        ("J02", 0b010001, False),  # neither is sent
        ("J02", 0b100001, False),
        ("G02", 0b000001, False),
    ],
)
def test_health_of_qzss_is_that_of_l1(satellite: str, bits: int, healthy: bool):
    assert (l1_health(satellite, bits) == 0) == healthy


def test_a_u_blox_log_brings_qzss(tmp_path: Path):
    samples = recorded()
    (wanted,) = [
        s.ephemeris
        for s in samples
        if isinstance(s, EphemerisSample) and s.ephemeris.satellite == "J03"
    ]
    assert isinstance(wanted, Ephemeris)
    epoch = next(s for s in samples if isinstance(s, Epoch))
    epoch = epoch.select([i for i, name in enumerate(epoch.satellites) if name == "J03"])
    log = tmp_path / "a.ubx"
    log.write_bytes(rawx(epoch) + broadcast(wanted))
    (read,), (sent,) = read_ubx(log)
    assert read.satellites == ("J03",)
    assert read.pseudorange_m == pytest.approx(epoch.pseudorange_m)
    assert isinstance(sent, EphemerisSample)
    assert isinstance(sent.ephemeris, Ephemeris)
    assert sent.ephemeris.satellite == "J03"
    # Far above the resolution of the message fields.
    np.testing.assert_allclose(
        pack_ephemeris(sent.ephemeris)[:16], pack_ephemeris(wanted)[:16], rtol=1e-9, atol=1e-8
    )
    assert pack_ephemeris(sent.ephemeris)[0] == GPS_GM_M3PS2

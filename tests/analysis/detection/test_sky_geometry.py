"""The sky of decisions on a real recording, against geometry written out here."""

import numpy as np
import pytest

from analysis.detection import Detector, DetectorConfig
from analysis.detection.recorded_sky import RecordedSky
from analysis.recordings.read_recordings import read_rinex
from analysis.results import Decision
from analysis.samples.block import EPOCH
from mavproxy_fault.numerics.earth import geodetic_from_ecef

SECONDS = 20


@pytest.fixture(scope="module")
def decisions(shared_data):
    folder = shared_data / "gnss_static"
    block = read_rinex(folder / "SEPT078M.21O", folder / "SEPT078M.21P")
    part = block.between(0, int(block.rows(EPOCH)[SECONDS]))
    detector = Detector()
    results, _ = detector.step(part, detector.new_state())
    sky = RecordedSky(part, DetectorConfig())
    return [r for r in sky.add_sky(results) if isinstance(r, Decision)]


def test_every_satellite_of_a_decision_has_its_place(decisions):
    assert len(decisions) == SECONDS
    for decision in decisions:
        count = len(decision.satellites)
        columns = decision.elevation_deg, decision.azimuth_deg, decision.cn0_dbhz, decision.signals
        assert [len(column) for column in columns] == [count] * 4
        assert min(decision.elevation_deg) >= 9.9
        assert set(decision.signals) == {"1C"}


def test_dilution_is_that_of_the_directions(decisions):
    decision = decisions[-1]
    el, az = np.radians(decision.elevation_deg), np.radians(decision.azimuth_deg)
    system = [[name[0] == "G", name[0] == "E"] for name in decision.satellites]
    north, east = np.cos(el) * np.cos(az), np.cos(el) * np.sin(az)
    design = np.column_stack([north, east, np.sin(el), np.array(system, float)])
    cofactor = np.diag(np.linalg.inv(design.T @ design))
    assert decision.hdop == pytest.approx((cofactor[0] + cofactor[1]) ** 0.5, abs=2e-3)
    assert decision.vdop == pytest.approx(cofactor[2] ** 0.5, abs=2e-3)


def test_a_satellite_at_the_zenith_is_overhead(decisions):
    decision = decisions[0]
    highest = max(zip(decision.elevation_deg, decision.satellites, strict=True))
    assert highest == (pytest.approx(85.4, abs=0.5), "G17")
    lat, lon, _ = geodetic_from_ecef(decision.position_ecef_m)
    assert np.degrees([lat, lon]) == pytest.approx([35.34, 139.52], abs=0.01)

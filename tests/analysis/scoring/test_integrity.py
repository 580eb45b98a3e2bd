"""The counts of a Stanford diagram."""

import numpy as np
import pytest

from analysis.recordings.position_reference import PositionReference
from analysis.results import Decision
from analysis.scoring.integrity import Integrity
from mavproxy_fault.numerics.earth import ecef_from_geodetic
from mavproxy_fault.numerics.earth_kernel import ned_axes

LAT, LON = np.radians(47.0), np.radians(8.0)
TRUE_M = ecef_from_geodetic(LAT, LON, 500.0)


def decision(north_m, down_m, hpl_m, vpl_m):
    position = TRUE_M + np.array([north_m, 0.0, down_m]) @ ned_axes(LAT, LON)
    return Decision(
        t_us=0, statistic=None, threshold=None, dof=0, p_value=None, alarm=False,
        hypothesis="none", position_ecef_m=tuple(position), hpl_m=hpl_m, vpl_m=vpl_m,
        level_assumes="that" if vpl_m else "",
    )  # fmt: skip


def test_errors_above_their_level_are_misleading():
    found = Integrity(PositionReference(np.zeros(1, np.int64), TRUE_M[None]))
    found.add([decision(3.0, 4.0, 6.0, 60.0), decision(9.0, 4.0, 6.0, 8.0)])
    found.add([decision(9.0, 4.0, None, 8.0)])
    rows = found.summary()
    assert rows["horizontal"] == {
        "epochs": 3,
        "with_level": 2,
        "median_level_m": 6.0,
        "misleading": 1,
        "largest_error_over_level": 1.5,
        "alert_limit_m": 40.0,
        "available_share": 1.0,
        "assumes": {"that": 3},
    }
    assert rows["vertical"]["misleading"] == 0
    assert rows["vertical"]["available_share"] == pytest.approx(2 / 3, abs=1e-3)


def test_without_a_truth_there_is_nothing_to_count():
    found = Integrity(None)
    found.add([decision(3.0, 4.0, 6.0, 60.0)])
    assert found.summary() == {}

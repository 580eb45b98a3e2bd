"""The simulator's pseudoranges against the analysis's own models, written apart from them.

What the monitor sees goes over the wire in between: RTCM ephemerides and MSM7.
"""

import math

import numpy as np
import pytest

from analysis.orbits.broadcast import pack_ephemeris, predict_ranges, satellite_states
from mavproxy_fault.numerics.earth import ecef_from_geodetic, rot_en
from mavproxy_fault.rtcm.ephemeris_messages import decode_ephemeris
from mavproxy_fault.rtcm.msm7 import decode_msm7, encode_epoch
from simvehicle.gnss.gnss_config import ClockConfig, GnssConfig
from simvehicle.sensors.readings import EphemerisReading, PseudorangeReading
from simvehicle.vehicles.body import Truth
from tests.simvehicle.gnss.gnss_parts import gnss_sensor

HOME = (math.radians(40.2), math.radians(-111.7))
V_NED = np.array([20.0, -15.0, 3.0])


def config(ionosphere: bool, troposphere: bool) -> GnssConfig:
    return GnssConfig(
        ionosphere=ionosphere,
        troposphere=troposphere,
        cn0_sigma_db=0.0,
        thermal=0.0,
        multipath=0.0,
        orbit_m=0.0,
        clock=ClockConfig(offset_s=0.0, drift=0.0, h0_s=0.0, h2_hz=0.0, galileo_offset_m=0.0),
    )


def differences(ionosphere: bool, troposphere: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Measured minus predicted range [m] and rate [m/s], and elevation [rad]."""
    sensor = gnss_sensor(config(ionosphere, troposphere), *HOME)
    zero = np.zeros(3)
    truth = Truth(
        0, *HOME, 1500.0, 1500.0, 0.0, zero, V_NED, np.array([1.0, 0.0, 0.0, 0.0]), zero, zero,
        zero, zero, 85_000.0, 280.0, 1.0, 16.0, 0.0, 1.0,
    )  # fmt: skip
    rng = np.random.default_rng(1)
    readings, _ = sensor.sample(truth, sensor.new_state(rng), rng)
    known = [decode_ephemeris(r.rtcm) for r in readings if isinstance(r, EphemerisReading)]
    packed = {e.satellite: pack_ephemeris(e) for e in known}
    (raw,) = [r for r in readings if isinstance(r, PseudorangeReading)]
    decoded = [
        decode_msm7(m)
        for m in encode_epoch(
            raw.tow_s, raw.satellites, raw.pseudorange_m, raw.doppler_mps, raw.cn0_dbhz
        )
    ]
    names = [name for d in decoded for name in d.satellites]
    code = np.array([p for d in decoded for p in d.pseudorange_m])
    rate = np.array([p for d in decoded for p in d.doppler_mps])
    states = satellite_states(
        np.array([packed[n] for n in names]), float(raw.week), raw.tow_s, code
    )
    coefficients = np.array(sensor.constellation.klobuchar)
    place, motion = ecef_from_geodetic(*HOME, 1500.0), rot_en(*HOME) @ V_NED
    model = predict_ranges(states, place, motion, raw.tow_s, coefficients)
    return code - model[:, 0], rate - model[:, 1], model[:, 5]


def test_both_models_agree_on_ranges_to_the_resolution_of_the_message() -> None:
    code, _, _ = differences(True, True)
    assert len(code) >= 9
    assert np.abs(code).max() < 2e-3  # 0.6 mm per count


def test_both_models_agree_on_rates_within_millimetres_per_second() -> None:
    _, rate, _ = differences(True, True)
    assert np.abs(rate).max() < 5e-3  # the analysis neglects what Sagnac's effect changes by


@pytest.mark.parametrize(
    ("ionosphere", "troposphere"), [(False, True), (True, False), (False, False)]
)
def test_what_the_simulator_leaves_out_the_analysis_misses(
    ionosphere: bool, troposphere: bool
) -> None:
    code, _, _ = differences(ionosphere, troposphere)
    assert code.max() < -1.0

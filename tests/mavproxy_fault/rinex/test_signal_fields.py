"""Plant parameters change exactly their observations by exactly their values."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavproxy_fault.numerics.constants import L1_HZ, SPEED_OF_LIGHT_MPS
from mavproxy_fault.rinex.observation_header import FIELD, ObservationField
from mavproxy_fault.rinex.range_epoch import RangeEpoch, Setting
from mavproxy_fault.rinex.signal_change import signal_changes
from mavproxy_fault.rinex.signal_fields import VALUE, write_change

L1_WAVE_M = SPEED_OF_LIGHT_MPS / L1_HZ
KINDS = ("C1C", "L1C", "D1C", "S1C")
HEALTHY = dict(zip(KINDS, (22_000_000.125, 115_000_000.25, -1_234.5, 45.0), strict=True))
SATELLITES = ("G01", "G02", "E01", "E02")
# The kinds of observation that each parameter changes.
TOUCHED = {
    "pseudorange_m": "C",
    "range_rate_mps": "D",
    "satellite_lost": "CLDS",
    "cn0_drop_db": "CDS",
    "spoof_clock_m": "CLD",
}


def line_of(satellite):
    return satellite + "".join(f"{value:{VALUE}.3f} 7" for value in HEALTHY.values())


def faulted(settings, seed=1):
    """Return the changed values of each satellite, NaN for a blank field."""
    lines = [line_of(satellite) for satellite in SATELLITES]
    rng = np.random.default_rng(seed)
    epoch = RangeEpoch(SATELLITES).with_settings(settings)
    for name, change in signal_changes(epoch, 0, None):
        at = SATELLITES.index(name)
        observations = [ObservationField(kind, at, 3 + FIELD * i) for i, kind in enumerate(KINDS)]
        write_change(lines, observations, name, change, rng)
    rows = [line.ljust(3 + FIELD * len(KINDS)) for line in lines]
    return {
        row[:3]: [float(row[c : c + VALUE].strip() or "nan") for c in range(3, 3 + 64, FIELD)]
        for row in rows
    }


def names(parameter, index):
    return {f"{parameter}[{index}]": Setting(12.0, 0.5)}


@given(
    st.sampled_from(sorted(TOUCHED)),
    st.sampled_from(("all", "G", "E", *SATELLITES)),
    st.floats(0.5, 15.0),
    st.floats(-5.0, 5.0),
)
def test_only_the_named_satellites_change(parameter, index, value, rate):
    after = faulted({f"{parameter}[{index}]": Setting(value, rate)})
    for satellite, values in after.items():
        named = index in ("all", satellite[0], satellite)
        differ = {k[0] for k, new in zip(KINDS, values, strict=True) if new != HEALTHY[k]}
        assert differ <= set(TOUCHED[parameter]) if named else not differ
        # The noise of code and Doppler may round to zero, but the parameter does not.
        assert not named or differ & set(TOUCHED[parameter])


def test_a_delay_that_grows_is_in_code_phase_and_doppler():
    code, phase, doppler, strength = faulted(names("spoof_clock_m", "G"))["G01"]
    assert code - HEALTHY["C1C"] == pytest.approx(12.0, abs=0.001)
    assert phase - HEALTHY["L1C"] == pytest.approx(12.0 / L1_WAVE_M, abs=0.001)
    assert doppler - HEALTHY["D1C"] == pytest.approx(-0.5 / L1_WAVE_M, abs=0.001)
    assert strength == HEALTHY["S1C"]


def test_a_jump_has_no_doppler():
    after = faulted({"spoof_clock_m[all]": Setting(300.0, 15_000.0)})["E01"]
    assert after[KINDS.index("D1C")] == HEALTHY["D1C"]
    assert after[KINDS.index("C1C")] - HEALTHY["C1C"] == pytest.approx(300.0, abs=0.001)


def test_a_weaker_signal_is_noisier_and_a_very_weak_one_is_lost():
    setting = {"cn0_drop_db[G01]": Setting(12.0, 0.0), "cn0_drop_db[G02]": Setting(20.5, 0.0)}
    found = [faulted(setting, seed) for seed in range(400)]
    assert np.isnan([after["G02"] for after in found]).all()
    code = np.array([after["G01"][0] for after in found]) - HEALTHY["C1C"]
    # 0.1 chips, 0.25 Hz: 0.184 m at 45 dBHz, 0.733 m at 33; 400 draws are within 4 sigma.
    wanted_m = (0.733**2 - 0.184**2) ** 0.5
    assert code.std() == pytest.approx(wanted_m, abs=4.0 * wanted_m / 800**0.5)
    assert {after["G01"][3] for after in found} == {33.0}

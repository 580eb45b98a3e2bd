"""RTKLIB computes the true position from the sensor's messages."""

import math
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest

from mavproxy_fault.numerics.earth import ecef_from_geodetic
from mavproxy_fault.rtcm.msm7 import encode_epoch
from simvehicle.gnss.gnss_config import ClockConfig, GnssConfig
from simvehicle.sensors.readings import EphemerisReading, PseudorangeReading
from simvehicle.vehicles.body import Truth
from tests.simvehicle.gnss.gnss_parts import gnss_sensor

TOOLS = ("convbin", "rnx2rtkp")
OPTIONS = """pos1-posmode=single
pos1-elmask=5
pos1-ionoopt=off
pos1-tropopt=off
pos1-navsys=9
out-solformat=xyz
out-timesys=gpst
"""  # navsys: GPS and Galileo


def solutions(folder: Path) -> np.ndarray:
    """Positions (n, 3) in m that RTKLIB computes from `raw.rtcm3`."""
    (folder / "options.conf").write_text(OPTIONS)
    for command in (
        ["convbin", "-r", "rtcm3", "-tr", "2021/03/19", "12:00:00", "-v", "3.03",
         "-o", "o.obs", "-n", "o.nav", "raw.rtcm3"],
        ["rnx2rtkp", "-k", "options.conf", "-o", "o.pos", "o.obs", "o.nav"],
    ):  # fmt: skip
        subprocess.run(command, check=True, capture_output=True, timeout=60, cwd=folder)
    lines = [x.split() for x in (folder / "o.pos").read_text().splitlines() if x[:1] != "%"]
    return np.array([[float(v) for v in parts[2:5]] for parts in lines])


@pytest.mark.skipif(
    any(shutil.which(tool) is None for tool in TOOLS), reason="RTKLIB is not installed"
)
@pytest.mark.parametrize("systems", [("GPS",), ("GPS", "Galileo")])
def test_rtklib_finds_the_truth_in_error_free_readings(
    systems: tuple[str, ...],
    perfect: GnssConfig,
    truth_at: Callable[..., Truth],
    home: tuple[float, float],
    tmp_path: Path,
) -> None:
    clock = ClockConfig(offset_s=1e-4, drift=1e-7, h0_s=0.0, h2_hz=0.0, galileo_offset_m=0.0)
    config = msgspec.structs.replace(perfect, systems=systems, clock=clock)
    sensor = gnss_sensor(config, *home)
    rng = np.random.default_rng(1)
    state = sensor.new_state(rng)
    stream = []
    for k in range(10):
        readings, state = sensor.sample(truth_at(t_us=1_000_000 * k), state, rng)
        stream += [r.rtcm for r in readings if isinstance(r, EphemerisReading)]
        (raw,) = [r for r in readings if isinstance(r, PseudorangeReading)]
        stream += encode_epoch(
            raw.tow_s,
            raw.satellites,
            raw.pseudorange_m.tolist(),
            raw.doppler_mps.tolist(),
            raw.cn0_dbhz.tolist(),
        )
    (tmp_path / "raw.rtcm3").write_bytes(b"".join(stream))
    solved = solutions(tmp_path)
    truth = ecef_from_geodetic(*home, 535.0)
    assert len(solved) == 10
    assert math.sqrt(np.max(np.sum((solved - truth) ** 2, axis=1))) < 0.005

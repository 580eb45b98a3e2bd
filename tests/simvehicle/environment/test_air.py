"""Atmosphere, gusts, shear, terrain and magnetic field."""

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.numerics.compile import compiled
from simvehicle.environment.air import GUST_LEVELS, pressure_altitude, standard_air, step_wind
from simvehicle.environment.geolocation import HomeFrame, locate_state
from simvehicle.environment.terrain import read_terrain_grid
from simvehicle.simulation.onboard_sensors import field_ned_gauss

LEVEL = np.array([0.0] * 6 + [1.0, 0.0, 0.0, 0.0])  # only its attitude has an effect


@compiled
def air_at(alt_m: float) -> tuple[float, float, float]:
    return standard_air(alt_m)


# Geometric height [m], pressure [Pa], temperature [K], density [kg/m^3]: ICAO Doc 7488, table 1.
ICAO = [
    (0.0, 101325.0, 288.15, 1.2250),
    (1000.0, 89876.3, 281.651, 1.11166),
    (5000.0, 54048.3, 255.676, 0.736429),
    (15000.0, 12111.8, 216.650, 0.194755),
]


@pytest.mark.parametrize(("alt", "pressure", "temperature", "density"), ICAO)
def test_the_standard_atmosphere_matches_icao(
    alt: float, pressure: float, temperature: float, density: float
) -> None:
    assert air_at(alt) == pytest.approx((pressure, temperature, density), rel=2e-5)


@pytest.mark.parametrize("alt", [-100.0, 0.0, 488.0, 3000.0])
def test_pressure_altitude_is_the_inverse(alt: float) -> None:
    assert pressure_altitude(air_at(alt)[0]) == pytest.approx(alt, abs=1e-6)


def gusts(level: str, airspeed: float, dt: float, count: int) -> np.ndarray:
    """Gusts (count, 3) in body axes."""
    rng = np.random.default_rng(2)
    filters = np.zeros(5)
    out = np.empty((count, 3))
    spectrum = GUST_LEVELS[level]
    draws = rng.standard_normal((count, 5))
    weather = np.array([*spectrum.sigma_mps, *spectrum.length_m, 1.0, 0.0, 0.0, 0.0, 0.0])
    ahead = np.array([airspeed, 0.0, 0.0])
    for k in range(count):
        step_wind(filters, draws[k], weather, LEVEL, ahead, 1.0, dt, out[k])
    return out


def test_gusts_have_the_deviations_of_their_level() -> None:
    # 8000 s at 25 m/s over 200 m and 50 m: 500 and 2000 independent samples.
    out = gusts("light", 25.0, 0.4, 20_000)[100:]
    expected = GUST_LEVELS["light"].sigma_mps
    assert out.std(axis=0) == pytest.approx(expected, rel=4.0 / np.sqrt(2.0 * 500.0))


def test_gusts_are_the_same_process_at_any_step() -> None:
    coarse, fine = gusts("light", 25.0, 0.4, 20_000), gusts("light", 25.0, 0.1, 80_000)
    assert fine[400:].std(axis=0) == pytest.approx(coarse[100:].std(axis=0), rel=0.18)


def test_gusts_decorrelate_over_length_divided_by_speed() -> None:
    out = gusts("light", 25.0, 0.4, 20_000)[100:, 0]
    lag = np.mean(out[20:] * out[:-20]) / out.var()  # 8 s = 200 m / 25 m/s
    assert lag == pytest.approx(np.exp(-1.0), abs=0.13)


def test_shear_is_a_power_law_above_the_ground() -> None:
    def wind(height: float) -> float:
        still, out = np.zeros(5), np.empty(3)
        weather = np.array([0.0, 0.0, 0.0, 200.0, 200.0, 50.0, 10.0, 0.2, 10.0, 0.0, 0.0])
        ahead = np.array([20.0, 0.0, 0.0])
        step_wind(np.zeros(5), still, weather, LEVEL, ahead, height, 0.01, out)
        return float(out[0])

    assert wind(10.0) == pytest.approx(10.0)
    assert wind(80.0) == pytest.approx(10.0 * 8.0**0.2)
    assert 0.0 < wind(-5.0) < 5.0


def test_a_position_far_from_home_has_a_tilted_vertical() -> None:
    home = HomeFrame.at(47.0, 8.0, 400.0, 48.0)
    x = np.zeros(13)
    x[6] = 1.0
    x[:3] = home.ned(47.1, 8.2, 1400.0)
    place = np.empty(19)
    locate_state(x, np.zeros(3), home.packed, place)
    assert np.degrees(place[:2]) == pytest.approx([47.1, 8.2], abs=1e-12)
    assert place[2] == pytest.approx(1448.0, abs=1e-7)
    # The vertical turns by 0.1 degrees of latitude and 0.2 of longitude (times the cosine).
    down = place[16:] / np.linalg.norm(place[16:])
    turned = np.degrees(np.arccos(down[2]))
    assert turned == pytest.approx(np.hypot(0.1, 0.2 * np.cos(np.radians(47.0))), rel=0.01)
    assert np.linalg.norm(place[9:13]) == pytest.approx(1.0, abs=1e-12)


# NOAA, WMM2025_TEST_VALUES.txt (table 6 of the WMM2025 technical report): height [m], latitude,
# longitude [deg], X, Y, Z [nT] at 2025.0.
WMM = [
    (0.0, 80.0, 0.0, 6521.6, 145.9, 54791.5),
    (0.0, 0.0, 120.0, 39677.8, -109.6, -10580.2),
    (100_000.0, -80.0, 240.0, 5907.6, 14780.3, -49540.7),
]


@pytest.mark.parametrize(("height", "lat", "lon", "x", "y", "z"), WMM)
def test_the_magnetic_field_is_that_of_the_world_magnetic_model(
    height: float, lat: float, lon: float, x: float, y: float, z: float
) -> None:
    field = field_ned_gauss(lat, lon, height, datetime(2025, 1, 1, tzinfo=UTC))
    assert np.array(field) * 1e5 == pytest.approx([x, y, z], abs=0.1)


def test_a_date_without_a_model_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"start.time = 1999"):
        field_ned_gauss(47.4, 8.5, 500.0, datetime(1999, 3, 19, tzinfo=UTC))


def test_an_earlier_date_uses_the_model_of_its_years() -> None:
    field = field_ned_gauss(47.4, 8.5, 500.0, datetime(2021, 3, 19, tzinfo=UTC))
    assert 0.46 < np.linalg.norm(field) < 0.50


ASC = "ncols 3\nnrows 2\nxllcorner 8.0\nyllcorner 47.0\ncellsize 0.1\n"


def test_a_terrain_grid_is_bilinear_between_cell_centres(tmp_path: Path) -> None:
    path = tmp_path / "hill.asc"
    path.write_text(ASC + "NODATA_value -9999\n10 20 30\n40 50 60\n")
    grid = read_terrain_grid(path)
    assert grid.ground(np.radians(47.05), np.radians(8.05)) == pytest.approx(40.0)
    assert grid.ground(np.radians(47.15), np.radians(8.25)) == pytest.approx(30.0)
    assert grid.ground(np.radians(47.10), np.radians(8.10)) == pytest.approx(30.0)
    assert grid.ground(np.radians(10.0), np.radians(0.0)) == pytest.approx(40.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (ASC + "10 20 30\n40 50\n", "has 5 values for 2 rows of 3"),
        (ASC + "NODATA_value -1\n10 20 30\n40 -1 60\n", "has cells without data"),
        ("ncols 3\n1 2 3\n", "lacks nrows"),
        ("ncols three\n", "not an ASCII raster"),
    ],
)
def test_a_wrong_terrain_grid_is_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "hill.asc"
    path.write_text(text)
    with pytest.raises(ConfigError, match=message):
        read_terrain_grid(path)

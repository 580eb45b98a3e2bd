import math
from pathlib import Path
from typing import Any

import pytest

from analysis.campaign.campaign_file import FaultChoice, read_campaign
from analysis.campaign.magnitude_unit import fault_unit, magnitude_units

LAT_RAD = math.radians(47.0)


def shown(magnitude: float | None, fault: str | None, target: Any = None, **keys: Any) -> str:
    choice = FaultChoice(fault=fault, target=target, **keys)
    return fault_unit(choice, LAT_RAD).describe(magnitude)


@pytest.mark.parametrize(
    ("fault", "target", "magnitude", "expected"),
    [
        # A degree of latitude at 47 degrees has 111.17 km, one of longitude 76.06 km.
        ("bias", "HIL_GPS.lat", 100_000, "1112 m"),
        ("bias", "HIL_GPS.lon", 100_000, "760.6 m"),
        ("drift", "HIL_GPS.lat", 300, "3.335 m/s"),
        ("ramp", "HIL_GPS.vn", 100, "1 m/s²"),
        ("constant", "HIL_GPS.lat", 473_977_420, "47.4 deg"),
        ("bias", "HIL_GPS.alt", 2_500, "2.5 m"),
        ("noise", "HIL_GPS.cog", 150, "1.5 deg"),
        ("bias", ["HIL_SENSOR.xgyro", "RAW_IMU.xgyro"], 0.3, "0.3 rad/s"),
        ("bias", "RAW_IMU.xgyro", 300, "0.3 rad/s"),
        ("bias", "SCALED_IMU.xacc", 1_000, "9.807 m/s²"),
        ("drift", "HIL_SENSOR.xacc", 0.1, "0.1 m/s³"),
        ("random-walk", "HIL_SENSOR.xgyro", 0.1, "0.1 rad/s/√s"),
        ("scale", "HIL_SENSOR.xgyro", 1.1, "1.1"),
        ("bias", "HIL_SENSOR.abs_pressure", 30, "30 hPa"),
        ("bias", "PSEUDORANGE.G12", 30, "30 m"),
        ("plant", "PLANT.wind_n_mps", 8, "8 m/s"),
        ("plant", "PLANT.mass_kg_add", 0.5, "0.5 kg"),
        ("plant", "PLANT.motor_efficiency[0]", 0.5, "0.5"),
        ("delay", "HIL_GPS", 0.2, "0.2 s"),
        ("drop", None, 0.5, "0.5"),
        ("freeze", "HIL_SENSOR.xgyro", None, ""),
    ],
)
def test_magnitudes_are_shown_in_units_of_people(
    fault: str, target: Any, magnitude: float | None, expected: str
) -> None:
    assert shown(magnitude, fault, target) == expected


def test_a_replaced_value_is_no_distance() -> None:
    impulse = {"period_s": 1.0, "width_s": 0.1}
    assert shown(3_000, "impulse", "HIL_GPS.lat", also=impulse) == "33.35 m"
    assert shown(3_000, "impulse", "HIL_GPS.lat", also={**impulse, "mode": "replace"}) == (
        "0.0003 deg"
    )


def test_another_key_has_the_unit_of_its_name() -> None:
    assert shown(5, "gps-spoof", sets="ramp_s") == "5 s"
    assert shown(5, None, preset="gps-jump", sets="offset_m") == "5 m"
    assert shown(5, "burst-loss", sets="frames") == "5"


def test_the_latitude_is_that_of_the_scenario(tmp_path: Path) -> None:
    text = (Path(__file__).parent / "short.yaml").read_text()
    assert "start: {height_m: 30}" in text
    moved = text.replace("{height_m: 30}", "{height_m: 30, lat_deg: 60, lon_deg: 10}")
    (tmp_path / "short.yaml").write_text(moved)
    (tmp_path / "c.yaml").write_text(
        "{subjects: [ekf], scenarios: [short.yaml], faults: "
        "[{id: east, fault: bias, target: HIL_GPS.lon, magnitudes: [10000]}]}"
    )
    # A degree of longitude at 60 degrees has 55.80 km.
    assert magnitude_units(read_campaign(tmp_path / "c.yaml"))["east"].describe(1e4) == "55.8 m"

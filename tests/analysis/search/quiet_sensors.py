"""Sensors without noise, for flights whose numbers are known."""

from analysis.search.space.test_file import SearchSensors

QUIET = SearchSensors(
    gyro_sigma_dps=0.0,
    accel_sigma_mps2=0.0,
    field_sigma_gauss=0.0,
    velocity_sigma_mps=0.0,
    pressure_sigma_pa=0.0,
)

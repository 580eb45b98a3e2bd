"""A point of a search as a scenario for `run`."""

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
from msgspec import to_builtins

from analysis.flying.onset import onset_keys
from analysis.search.space.airframe import has_rotors
from analysis.search.space.dimensions import section_values, target_of
from analysis.search.space.fault_picks import expand_picks
from analysis.search.space.fault_range import healthy_value
from analysis.search.space.test_file import AUTOPILOT, TestFile
from mavproxy_fault.documents.errors import ConfigError
from simvehicle.environment.air import SEA_LEVEL_K, SEA_LEVEL_PA
from simvehicle.scenario.changed_scenario import with_value

Document = dict[str, Any]
# Of compiled flights: normal gravity at sea level is 9.80665 m/s^2 there (WGS 84).
LATITUDE_DEG = 45.497
# Usual sample rates of GPS receiver, magnetometer and pressure sensors on a small aircraft.
GPS_HZ, FIELD_HZ, PRESSURE_HZ = 5.0, 25.0, 10.0


def document_of(test: TestFile, values: Mapping[str, float], seed: int) -> Document:
    """The scenario of these values, with faults and monitor.

    Parameters
    ----------
    test : TestFile
    values : mapping
        Numbers by name, as the test's space gives them.
    seed : int
        Seed of the simulator's noise.
    """
    test, values = expand_picks(test, values)
    if test.scenario is None:
        document = _flight(test, values)
    else:
        assert isinstance(test.scenario, dict)
        document = _varied(test.scenario, values)
    schedule = document.get("schedule")
    # The scenario's own faults are kept and come first.
    own_schedule = schedule if isinstance(schedule, dict) else {"faults": schedule or []}
    monitor = dict(document.get("monitor") or {})
    monitor["attitude"] = {
        **(monitor.get("attitude") or {}),
        # An autopilot is scored by the attitude it sends, not by a built-in estimator.
        "estimators": [] if test.estimator == AUTOPILOT else [test.estimator],
        "settle_s": test.settle_s,
    }
    required = {} if test.violate is None else {"requirements": [to_builtins(test.requirement)]}
    return {
        **document,
        **required,
        "seed": seed,
        "schedule": {**own_schedule, "faults": [*own_schedule["faults"], *faults_of(test, values)]},
        "monitor": monitor,
    }


def faults_of(test: TestFile, values: Mapping[str, float]) -> list[Document]:
    """The drawn faults as schedule entries; those of zero duration are left out."""
    entries = []
    test, values = expand_picks(test, values)
    for i, fault in enumerate(test.faults):
        name = f"faults[{i}]"
        # A schedule rejects a fault of zero duration; in a search it means no fault.
        if values.get(f"{name}.for_s") == 0.0:
            continue
        # As reduced to none of it.
        if test.violate and values.get(f"{name}.value") == healthy_value(fault.fault):
            continue
        keys = [key for key in ("value", "at_s", "for_s") if f"{name}.{key}" in values]
        on = fault.on[min(int(values.get(f"{name}.on", 0.0)), len(fault.on) - 1)]
        entries.append(
            {
                "id": f"drawn-{i}",
                "fault": fault.fault,
                "target": target_of(test, i, values[f"{name}.target"]),
                **(onset_keys(on) if on else {}),
                **{key: float(values[f"{name}.{key}"]) for key in keys},
                **fault.also,
            }
        )
    return entries


def _varied(scenario: Document, values: Mapping[str, float]) -> Document:
    """The scenario with its varied numbers replaced."""
    document = scenario
    for name, value in values.items():
        if name.startswith("vary."):
            try:
                document = with_value(document, name.removeprefix("vary."), float(value))
            except ConfigError as error:
                # With the name of the test file's key.
                raise ConfigError(f"vary.{error}") from None
    return document


def _flight(test: TestFile, values: Mapping[str, float]) -> Document:
    """The search's own aircraft in the simulator: the same start, controls, air and sensors."""
    part = partial(section_values, values)
    start, sensors = part("initial"), part("sensors")
    height_m = start.pop("height_m")
    heading_deg = start.pop("yaw_deg")
    # The sections have the same keys as a scenario.
    wind = part("wind")
    return {
        "name": "worst case",
        "duration_s": test.duration_s,
        "start": {
            "lat_deg": LATITUDE_DEG,
            # The home altitude gives the test's air density at the flight's height.
            "alt_m": altitude_of(test.density_kgpm3) - height_m,
            "height_m": height_m,
            "heading_deg": heading_deg,
            "state": start,
        },
        **_controlled(test, part("controls"), part("mission")),
        "environment": {
            "wind_ned_mps": [wind[f"{axis}_mps"] for axis in ("north", "east", "down")],
            "gusts": test.gusts,
        },
        "sensors": _sensors(test, sensors),
        "monitor": {"attitude": {"declination_deg": test.declination_deg}},
    }


def _controlled(test: TestFile, controls: Document, mission: Document) -> Document:
    """The sections `vehicle` and `controls`."""
    if has_rotors(test.vehicle):
        # Without a mission it hovers.
        mission = mission or {"roll_deg": 0.0, "period_s": 1.0, "pitch_deg": 0.0}
        weave = {key: value for key, value in mission.items() if key != "airspeed_mps"}
        kind, controls = "multirotor", {"weave": weave}
    else:
        kind = "fixedwing"
        if test.mission is not None:
            controls["weave"] = mission
    return {"vehicle": {"kind": kind, "parameters": test.vehicle}, "controls": controls}


def _sensors(test: TestFile, values: Mapping[str, float]) -> Document:
    gyro = np.radians([values[f"gyro_bias_{axis}_dps"] for axis in "xyz"])
    pitot = {"rate_hz": PRESSURE_HZ, "noise": {"sigma": values["pressure_sigma_pa"]}}
    return {
        "imu": {
            "rate_hz": 1.0 / test.dt_s,
            "gyro": {
                "sigma": float(np.radians(values["gyro_sigma_dps"])),
                "bias": gyro.tolist(),
            },
            "accel": {
                "sigma": values["accel_sigma_mps2"],
                "bias": [values[f"accel_bias_{axis}_mps2"] for axis in "xyz"],
            },
        },
        "mag": {
            "rate_hz": FIELD_HZ,
            "field_ned_gauss": [*test.field_ned_gauss],
            "noise": {"sigma": values["field_sigma_gauss"]},
        },
        "baro": {
            "rate_hz": FIELD_HZ,
            "noise": {"sigma": values["static_sigma_pa"], "bias": [values["static_bias_pa"]]},
            "drift_pa_per_k": values["static_drift_pa_per_k"],
        },
        "airspeed": None if has_rotors(test.vehicle) else pitot,
        "gps": {
            "rate_hz": GPS_HZ,
            "horizontal": {"kick_m": values["position_kick_m"], "k_per_s": test.position_k_per_s},
            "vertical": {"kick_m": values["height_kick_m"], "k_per_s": test.position_k_per_s},
            "velocity": {"sigma": values["velocity_sigma_mps"]},
        },
    }


def altitude_of(density_kgpm3: float) -> float:
    """Height above sea level [m] at which the standard troposphere has this density."""
    # Ideal gas: density by pressure and temperature at sea level.
    sea = SEA_LEVEL_PA / (287.05287 * SEA_LEVEL_K)
    ratio = density_kgpm3 / sea
    return float(SEA_LEVEL_K / 0.0065 * (1.0 - ratio ** (1.0 / 4.25588)))  # ICAO Doc 7488

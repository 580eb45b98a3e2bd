"""Plots of a simulated flight: the ground track and the states over time, as PNG, SVG or PDF."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.extras import import_extra
from mavproxy_fault.numerics.arrays import Array
from mavproxy_fault.numerics.rotations.rotation import euler_from_quat
from simvehicle.guidance.route import PathTrack
from simvehicle.scenario.scenario_file import Scenario
from simvehicle.simulation.simulation import Simulation

_PICTURE_SUFFIXES = (".png", ".svg", ".pdf")


@dataclass(frozen=True, slots=True)
class PlottedFlight:
    """A completed flight sampled at about 10 Hz; arrays have n rows.

    Time [s], position NED and height above ground [m], velocity NED and airspeed [m/s], roll,
    pitch, yaw [deg], body rates [deg/s], controls and their names; and the planned path (m, 2) [m].
    """

    t_s: Array
    r_ned_m: Array
    height_agl_m: Array
    v_ned_mps: Array
    airspeed_mps: Array
    euler_deg: Array
    rates_dps: Array
    controls: Array
    plan_m: Array
    actuators: list[str]


def trace_flight(scenario: Scenario, seed: int | None = None) -> PlottedFlight:
    """Fly a scenario with the built-in controller and record the plotted quantities."""
    # `None`: the scenario's own seed.
    simulation = Simulation(scenario, seed)
    track = simulation.controller.track
    plan = np.zeros((0, 2))
    if isinstance(track, PathTrack):
        plan = np.stack([track.path.north_m, track.path.east_m], axis=-1)
    rows: list[tuple[Any, ...]] = []
    next_us = 0
    while simulation.truth.t_us < scenario.duration_s * 1e6:
        t_us, truth, _ = simulation.step()
        # About 10 Hz: a plot resolves no more.
        if t_us < next_us:
            continue
        next_us = t_us + 100_000
        rows.append(
            (
                t_us * 1e-6,
                truth.r_ned_m,
                truth.height_agl_m,
                truth.v_ned_mps,
                float(np.linalg.norm(truth.v_air_b_mps)),
                np.degrees(euler_from_quat(truth.q_nb)),
                np.degrees(truth.omega_b_rps),
                simulation.controls,
            )
        )
    t, r, height, v, airspeed, euler, rates, controls = map(np.array, zip(*rows, strict=True))
    names = simulation.kind.actuators(simulation.vehicle)
    return PlottedFlight(t, r, height, v, airspeed, euler, rates, controls, plan, names)


def plot_scenario(scenario: Scenario, seed: int | None, path: str | Path) -> int:
    """Fly a scenario and plot it; returns the exit code."""
    # Checked before the flight, which may take minutes.
    if Path(path).suffix.lower() not in _PICTURE_SUFFIXES:
        known = ", ".join(_PICTURE_SUFFIXES)
        raise ConfigError(f"--plot: {path} is not a picture file; use one of {known}")
    figure = draw_flight(trace_flight(scenario, seed), scenario.name)
    try:
        figure.savefig(path, dpi=110)
    except OSError as error:
        raise ConfigError(f"--plot: {path} cannot be written ({error.strerror})") from None
    sys.stderr.write(f"wrote {path}\n")
    return 0


def draw_flight(flight: PlottedFlight, title: str) -> Any:
    """Draw the path on the left and the states over time on the right."""
    # `Figure` without pyplot keeps no global state and needs no display.
    figure = import_extra("matplotlib.figure").Figure(figsize=(14.0, 8.5), layout="constrained")
    figure.suptitle(title)
    halves: Any = figure.subfigures(1, 2, width_ratios=(1.0, 1.1))
    left, right = halves
    draw_path(left.subplots(), flight)
    panels = [
        ("height above ground [m]", flight.height_agl_m[:, None], [""]),
        ("speed [m/s]", _speeds(flight), ["airspeed", "over ground"]),
        ("attitude [deg]", _break_at_wraps(flight.euler_deg), ["roll", "pitch", "yaw"]),
        ("body rates [deg/s]", flight.rates_dps, ["p", "q", "r"]),
        ("controls", flight.controls, flight.actuators),
    ]
    for axes, (label, values, legend) in zip(
        right.subplots(len(panels), 1, sharex=True), panels, strict=True
    ):
        for column, name in zip(values.T, legend, strict=True):
            axes.plot(flight.t_s, column, linewidth=0.9, label=name or None)
        axes.set_ylabel(label, fontsize=8)
        axes.grid(alpha=0.3)
        # A single curve needs no legend: the axis label names it.
        if len(legend) > 1:
            axes.legend(fontsize=7, ncols=len(legend), loc="upper right")
    axes.set_xlabel("time [s]")
    return figure


def draw_path(axes: Any, flight: PlottedFlight) -> None:
    """Draw the planned and the flown path, north up."""
    if len(flight.plan_m):
        axes.plot(flight.plan_m[:, 1], flight.plan_m[:, 0], "--", color="0.6", label="planned")
    axes.plot(flight.r_ned_m[:, 1], flight.r_ned_m[:, 0], color="tab:blue", label="flown")
    # The plot's x axis is east: swap north and east.
    axes.plot(*flight.r_ned_m[0, 1::-1], "o", color="tab:green", label="start")
    # Equal scales, so that a circle looks like a circle.
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("east [m]")
    axes.set_ylabel("north [m]")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)


def _speeds(flight: PlottedFlight) -> Array:
    ground = np.hypot(flight.v_ned_mps[:, 0], flight.v_ned_mps[:, 1])
    return np.stack([flight.airspeed_mps, ground], axis=-1)


def _break_at_wraps(angles_deg: Array) -> Array:
    """Angles with a gap instead of a line where they wrap."""
    out = angles_deg.copy()
    # A jump of over half a turn between two samples is a wrap, not motion.
    out[1:][np.abs(np.diff(angles_deg, axis=0)) > 180.0] = np.nan
    return out

"""Both vehicles fly every shape in 8 m/s of wind: a table of errors and a plot for each vehicle.

Run it manually: `python benchmarks/shapes.py docs` writes `shapes-fixedwing.png` and
`shapes-multirotor.png` to the folder.
"""

import sys
from pathlib import Path
from typing import Any

import numpy as np

from simvehicle.guidance.mission import smallest_size, turn_radius
from simvehicle.guidance.route import PathTrack
from simvehicle.scenario.scenario_file import (
    Environment,
    Leg,
    Scenario,
    SensorSuite,
    StartConfig,
    VehicleChoice,
)
from simvehicle.sensors.imu import ImuSensor
from simvehicle.simulation.simulation import Simulation

WIND = Environment(wind_ned_mps=(5.657, 5.657, 0.0), gusts="light")
SHAPES = ("triangle", "diamond", "trapezoid", "s", "eight", "circle", "line", "all in sequence")
MARGINS = {"triangle": 2.2, "diamond": 1.8, "trapezoid": 2.2}  # size over the smallest size
# Vehicle, speed [m/s], wind speed for the turns [m/s], smallest size [m].
VEHICLES = {
    "fixedwing": (VehicleChoice(kind="fixedwing", parameters="aerosonde-2025"), 25.0, 8.0, 400.0),
    "multirotor": (VehicleChoice(kind="multirotor", parameters="iris"), 6.0, 0.0, 60.0),
}


def legs(shape: str, speed: float, wind: float, accel: float, least: float) -> list[Leg]:
    """The shape, or all shapes in sequence, larger than the smallest size."""
    radius = turn_radius(speed, wind, accel)
    names = SHAPES[:-1] if shape == SHAPES[-1] else (shape,)
    return [
        Leg(
            shape=name,  # type: ignore[arg-type]
            size_m=float(
                np.ceil(max(least, MARGINS.get(name, 1.15) * smallest_size(name, radius)) / 10.0)
                * 10.0
            ),
            height_m=80.0,
            speed_mps=speed,
        )
        for name in names
    ]


def fly_shape(kind: str, shape: str) -> tuple[Any, np.ndarray, np.ndarray]:
    """Size; planned path (m, 2); flown north, east, cross-track and height error (n, 4)."""
    choice, speed, wind, least = VEHICLES[kind]
    accel = 6.87 if kind == "fixedwing" else 3.0
    scenario = Scenario(
        start=StartConfig(height_m=80.0),
        vehicle=choice,
        environment=WIND,
        mission=legs(shape, speed, wind, accel, least),
        sensors=SensorSuite(imu=ImuSensor(rate_hz=125.0)),
    )
    simulation = Simulation(scenario)
    track = simulation.controller.track
    assert isinstance(track, PathTrack)
    rows = []
    while not track.finished:
        _, truth, _ = simulation.step()
        north, east, _ = truth.r_ned_m.tolist()
        error = track.setpoint_from(north, east, 0.0).cross_track_m
        rows.append((north, east, error, truth.height_agl_m - 80.0))
    plan = np.stack([track.path.north_m, track.path.east_m], axis=-1)
    return scenario.mission[0].size_m, plan, np.array(rows)


def main(folder: Path) -> None:
    """Print the table and draw the plots."""
    from matplotlib.figure import Figure

    print("| vehicle | shape | size m | across track, max m | rms m | height, max m |")
    print("|---|---|---|---|---|---|")
    for kind in VEHICLES:
        figure = Figure(figsize=(16.0, 8.5), layout="constrained")
        figure.suptitle(
            f"{kind}: planned (grey) and flown (blue) in 8 m/s of wind to the north-east"
        )
        for axes, shape in zip(figure.subplots(2, 4).flat, SHAPES, strict=True):
            size, plan, rows = fly_shape(kind, shape)
            across, height = np.abs(rows[:, 2]), np.abs(rows[:, 3])
            rms = float(np.sqrt(np.mean(across**2)))
            shown = f"{size:.0f}" if shape != SHAPES[-1] else "-"
            print(
                f"| {kind} | {shape} | {shown} | {across.max():.1f} | {rms:.2f} "
                f"| {height.max():.1f} |",
                flush=True,
            )
            axes.plot(plan[:, 1], plan[:, 0], color="0.75", linewidth=4.0)
            axes.plot(rows[:, 1], rows[:, 0], color="tab:blue", linewidth=1.0)
            axes.plot(*plan[0, ::-1], "o", color="tab:green")
            axes.set_aspect("equal", adjustable="datalim")
            axes.set_title(f"{shape}: at most {across.max():.1f} m off", fontsize=10)
            axes.grid(alpha=0.3)
        figure.savefig(folder / f"shapes-{kind}.png", dpi=70)


if __name__ == "__main__":
    main(Path(sys.argv[1]))

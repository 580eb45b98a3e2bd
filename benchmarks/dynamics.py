"""Speed of the vehicle models: the bare kernel, single vehicles, and complete simulations.

Run it manually: `python benchmarks/dynamics.py`. Times are CPU time of this process, the best of 25
rounds, as machines are rarely idle; compilation is excluded.
"""

import time
from collections.abc import Callable

import msgspec
import numpy as np

from mavproxy_fault.numerics.compile import compiled, inlined
from simvehicle.hil.hil_frames import HilPacker
from simvehicle.scenario.scenario_file import (
    Environment,
    Leg,
    Scenario,
    VehicleChoice,
    read_scenario,
)
from simvehicle.sensors.battery import BatteryMonitor
from simvehicle.sensors.error_model import NoiseModel
from simvehicle.sensors.flow import OpticalFlow
from simvehicle.sensors.rangefinder import Rangefinder
from simvehicle.sensors.vision import Vision
from simvehicle.simulation.simulation import Simulation
from simvehicle.vehicles.fixedwing.fixedwing import FixedWing
from simvehicle.vehicles.fixedwing.fixedwing_kernel import Aero, WingInputs, state_derivative
from simvehicle.vehicles.fixedwing.fixedwing_parameters import aero_coefficients
from simvehicle.vehicles.parameter_file import body_inertia
from simvehicle.vehicles.rigidbody_kernel import Inertia, finish_step

LANES = 32
STEPS = 2000
ROUNDS = 25


@inlined
def step(
    x: tuple[float, ...], u: tuple[float, ...], body: Inertia, aero: Aero
) -> tuple[float, ...]:
    """One Runge-Kutta step of 10 ms."""
    given = WingInputs(u, (0.0, 0.0, 0.0), (0.0, 0.0, 9.81), 1.2682, body, aero)
    return finish_step(x, state_derivative(x, given), state_derivative, given, given, 0.01)


@compiled
def lanes(x: np.ndarray, u: np.ndarray, body: Inertia, aero: Aero, n: int) -> None:
    """Step 32 vehicles `n` times; `x` (13 * 32,) and `u` (4 * 32,) hold one row per quantity."""
    for _ in range(n):
        for i in range(32):
            s = (
                x[i], x[32 + i], x[64 + i], x[96 + i], x[128 + i], x[160 + i], x[192 + i],
                x[224 + i], x[256 + i], x[288 + i], x[320 + i], x[352 + i], x[384 + i],
            )  # fmt: skip
            c = (u[i], u[32 + i], u[64 + i], u[96 + i])
            s = step(s, c, body, aero)
            x[i], x[32 + i], x[64 + i], x[96 + i], x[128 + i] = s[0], s[1], s[2], s[3], s[4]
            x[160 + i], x[192 + i], x[224 + i], x[256 + i] = s[5], s[6], s[7], s[8]
            x[288 + i], x[320 + i], x[352 + i], x[384 + i] = s[9], s[10], s[11], s[12]


@compiled
def single(
    x: tuple[float, ...], u: tuple[float, ...], body: Inertia, aero: Aero, n: int
) -> tuple[float, ...]:
    """Step one vehicle `n` times."""
    for _ in range(n):
        x = step(x, u, body, aero)
    return x


def best(call: Callable[[], object]) -> float:
    """Shortest CPU time of a call [s]."""
    call()
    times = []
    for _ in range(ROUNDS):
        start = time.process_time()
        call()
        times.append(time.process_time() - start)
    return min(times)


def kernels() -> None:
    """Vehicle-steps per second of the Runge-Kutta kernel."""
    parameters = FixedWing.read("aerosonde-2025").parameters
    body, aero = body_inertia(parameters, {}), aero_coefficients(parameters, {})
    x = np.zeros(13 * LANES)
    x[96:128], x[192:224] = 25.0, 1.0
    u = np.zeros(4 * LANES)
    u[:32], u[96:] = -0.12, 0.77
    seconds = best(lambda: lanes(x.copy(), u, body, aero, STEPS))
    print(f"| RK4 step, {LANES} lanes | {LANES * STEPS / seconds / 1e6:.1f} million steps/s |")
    one = (0.0, 0.0, 0.0, 25.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    control = (-0.12, 0.0, 0.0, 0.77)
    seconds = best(lambda: single(one, control, body, aero, 10 * STEPS))
    print(f"| RK4 step, one vehicle | {10 * STEPS / seconds / 1e6:.2f} million steps/s |")


def simulation(name: str, scenario: Scenario, frames: bool) -> None:
    """Print the speed of a simulation at 250 Hz, with or without HIL frames packed."""
    flight = Simulation(scenario)
    packer = HilPacker(flight.board)

    def second() -> None:
        for _ in range(250):
            result = flight.step()
            if frames:
                packer.frames(result[2])

    seconds = best(second)  # for one simulated second, including its GNSS epochs
    what = "with HIL frames packed" if frames else "readings only"
    print(f"| {name}, {what} | {1.0 / seconds:.0f} x real time, {seconds * 4000:.0f} us/step |")


def main() -> None:
    """Print the table."""
    demo = read_scenario(None)
    white = NoiseModel(sigma=0.01)
    every = msgspec.structs.replace(
        demo.sensors,
        range=Rangefinder(noise=white, max_m=200.0),
        flow=OpticalFlow(flow=white, gyro=white, max_m=200.0),
        vision=Vision(position=white, velocity=white, attitude=white),
        battery=BatteryMonitor(voltage=white, current=white),
    )
    demo = msgspec.structs.replace(demo, sensors=every)
    quad = msgspec.structs.replace(
        demo,
        vehicle=VehicleChoice(kind="multirotor", parameters="iris"),
        mission=[Leg(shape="eight", size_m=300.0, height_m=100.0, speed_mps=6.0, laps=20)],
        environment=Environment(wind_ned_mps=(2.0, -3.0, 0.0), gusts="light"),
    )
    print("| what | speed |\n|---|---|")
    kernels()
    simulation("demo with all sensors but GNSS", msgspec.structs.replace(demo, gnss=None), False)
    for name, scenario in (("demo with all sensors", demo), ("quad in its place", quad)):
        simulation(name, scenario, False)
        simulation(name, scenario, True)


if __name__ == "__main__":
    main()

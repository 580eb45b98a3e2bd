"""Speed of the vehicle models: the bare kernel, single vehicles, and complete simulations.

Run it manually: `python benchmarks/dynamics.py`. Times are CPU time of this process, the best of 25
rounds, as machines are rarely idle; compilation is excluded.
"""

import time
from collections.abc import Callable

import msgspec

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
from simvehicle.vehicles.fixedwing.fixedwing_kernel import Aero, WingInputs, forces_moments
from simvehicle.vehicles.fixedwing.fixedwing_parameters import aero_coefficients
from simvehicle.vehicles.parameter_file import body_inertia
from simvehicle.vehicles.rigidbody_kernel import Inertia, Loads, State13, runge_kutta_step

STEPS = 2000
ROUNDS = 25


@inlined
def loads(state: State13, stage: int, given: WingInputs) -> Loads:
    """Force and moment of still air."""
    _, _, _, u, v, w, _, _, _, _, p, q, r = state
    return forces_moments((u, v, w), (p, q, r), given.controls, given.density, given.aero)


@compiled
def single(
    x: State13, u: tuple[float, float, float, float], body: Inertia, aero: Aero, n: int
) -> State13:
    """Fly `n` Runge-Kutta steps of 10 ms in still air."""
    gravity = (0.0, 0.0, 9.81)
    given = WingInputs(u, (0.0, 0.0, 0.0), gravity, 1.2682, body, aero)
    for _ in range(n):
        x = runge_kutta_step(x, loads, given, gravity, body, 0.01)
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

"""Which actuator is isolated when a motor or surface fails, and in gusts alone, over seeds.

`python benchmarks/actuator_watch.py` flies the examples' quad, the hexarotor and the demo's fixed
wing by the simulator alone, `SEEDS` flights per fault and over an hour of gusts each, gives their
IMU, airspeed and commands to the monitor's actuator channel, and prints the tables of
docs/watches.md.
"""

import functools
from collections import Counter
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from analysis.detection.actuators.actuator_detector import ActuatorDetector
from analysis.detection.actuators.effects import COMMANDS, unknown_effects
from analysis.run.run_setup import read_setup
from analysis.run.vehicle_effects import vehicle_effects
from analysis.samples.block import AIRSPEED, COMMAND, CONTROLS, FIX, IMU, WIDTH, Block
from mavproxy_fault.wire.frame import Frame, build_frame
from mavproxy_fault.wire.parser import Parser
from simvehicle.hil.actuator_commands import ActuatorCommands
from simvehicle.scenario.scenario_file import Scenario
from simvehicle.sensors.compiled_sensor import IMU as IMU_SENSOR
from simvehicle.sensors.compiled_sensor import PITOT
from simvehicle.simulation.simulation import Simulation
from simvehicle.simulation.vehicle_kinds import find_vehicle_kind
from simvehicle.vehicles.body import Controls

SEEDS, GUSTY_SEEDS = range(1, 7), range(11, 24)
LEARNED = "quad, effects learned"
START_S = 60.0  # begin of faults: the effects are learned by then
FAULTY_S, GUSTY_S = 60.0, 300.0  # a stuck actuator shows only when it should move
IMU_HZ = 100.0
LOW_M = 0.5  # a vehicle below it has come down
HOVER = Path(__file__).parents[1] / "examples" / "hover.yaml"
FIX_3D = 3.0
CRUISE = (5.0, 0.0, 0.0)  # a velocity in flight


class Fault(NamedTuple):
    """A fault of an actuator: a plant fault, or a command that it does not follow.

    `number` is the actuator's; `does` is "stuck" or its position instead of its command.
    """

    name: str
    number: int
    plant: str = ""
    value: float = 0.0
    does: str | float | None = None


ROTORS = (
    *(Fault("20 % of a motor's power", i, f"motor_efficiency[{i}]", 0.8) for i in (1, 2)),
    *(Fault("a motor stops", i, f"motor_efficiency[{i}]", 0.0) for i in (1, 2)),
    *(Fault("a motor at full speed", i, does=1.0) for i in (1, 2)),
    *(Fault("a motor stuck where it is", i, does="stuck") for i in (1, 2)),
)
SURFACES = ("elevator", "aileron", "rudder")
WING = (
    Fault("20 % of the motor's power", 3, "motor_efficiency[0]", 0.8),
    Fault("the motor stops", 3, "motor_efficiency[0]", 0.0),
    Fault("20 % of the elevator", 0, "elevator_efficiency", 0.8),
    Fault("half the elevator", 0, "elevator_efficiency", 0.5),
    *(Fault(f"{name} hard over", i, does=1.0) for i, name in enumerate(SURFACES)),
    *(Fault(f"{name} stuck where it is", i, does="stuck") for i, name in enumerate(SURFACES)),
)
FAULTS = {"quad": ROTORS, LEARNED: ROTORS, "hexa": ROTORS, "fixed wing": WING}


@functools.cache
def scenario_of(vehicle: str) -> Scenario:
    """A vehicle without GNSS."""
    scenario = read_setup(None if vehicle == "fixed wing" else str(HOVER)).scenario
    if vehicle == "hexa":
        parameters = msgspec.structs.replace(scenario.vehicle, parameters="hexa")
        scenario = msgspec.structs.replace(scenario, vehicle=parameters)
    imu = msgspec.structs.replace(scenario.sensors.imu, rate_hz=IMU_HZ)
    sensors = msgspec.structs.replace(scenario.sensors, imu=imu)
    return msgspec.structs.replace(scenario, sensors=sensors, gnss=None)


def flown(vehicle: str, seed: int, duration_s: float, fault: Fault | None) -> Block:
    """IMU, airspeed and commands of a flight until it comes down; a fix shows that it flies."""
    scenario = scenario_of(vehicle)
    gusts: Any = "moderate" if seed % 2 else "light"
    air = msgspec.structs.replace(scenario.environment, gusts=gusts)
    simulation = Simulation(
        msgspec.structs.replace(scenario, seed=seed, duration_s=duration_s, environment=air)
    )
    kind = find_vehicle_kind(scenario.vehicle.kind)
    commands = ActuatorCommands(kind.actuators(simulation.vehicle), kind.mix(simulation.vehicle))
    parser, rows, held = Parser(), [], None
    while simulation.truth.t_us < duration_s * 1e6 and simulation.truth.height_agl_m > LOW_M:
        t_us = simulation.truth.t_us
        values = np.array(simulation.commanded())
        raw = build_frame(*commands.message(t_us, values))
        (frame,) = parser.push(raw, datagram=True)
        assert isinstance(frame, Frame)
        rows.append((COMMAND, t_us, [*frame.values()["controls"][:COMMANDS], CONTROLS]))
        if len(rows) == 1:  # samples before the first command are ignored
            rows.append((FIX, t_us, [0.0] * 3 + list(CRUISE) + [FIX_3D]))
        if fault is not None and t_us >= START_S * 1e6:
            held = values if held is None else held
            if fault.plant:
                simulation.plant(fault.plant, fault.value)
            else:
                values[fault.number] = held[fault.number] if fault.does == "stuck" else fault.does
        t_us, _, _ = simulation.step(Controls(values))
        for sensor in simulation.board.sensors:
            seen = sensor["values"].tolist()
            if sensor["fresh"] and sensor["kind"] == IMU_SENSOR:
                rows.append((IMU, t_us, [*seen[3:], *seen[:3]]))
            elif sensor["fresh"] and sensor["kind"] == PITOT:
                rows.append((AIRSPEED, t_us, seen[:1]))
    table = np.zeros((len(rows), WIDTH))
    for at, (_, _, numbers) in enumerate(rows):
        table[at, : len(numbers)] = numbers
    return Block(np.array([r[0] for r in rows]), np.array([r[1] for r in rows]), table, {})


def isolated(vehicle: str, block: Block) -> list[tuple[str, float]]:
    """The isolated actuators or pairs, and when each was first."""
    known = vehicle != LEARNED
    detector = ActuatorDetector(
        vehicle_effects(scenario_of(vehicle)) if known else unknown_effects()
    )
    results, _ = detector.step(block, detector.new_state())
    first: dict[str, float] = {}
    for _, result in results:
        if result.alarm:
            first.setdefault(result.suspect, result.t_us * 1e-6)
    return list(first.items())


def cell(vehicle: str, faults: list[Fault]) -> str:
    """A cell of the table: how many faults were isolated, and how soon."""
    names = find_vehicle_kind(scenario_of(vehicle).vehicle.kind)
    actuators = names.actuators(names.read(scenario_of(vehicle).vehicle.parameters))
    counts, delays = Counter[str](), []
    for fault in faults:
        for seed in SEEDS:
            found = isolated(vehicle, flown(vehicle, seed, START_S + FAULTY_S, fault))
            verdict, own = "missed", actuators[fault.number]
            at_s = {name: when for name, when in found if when >= START_S}
            if any(own not in name.split("-or-") for name, _ in found) or len(at_s) < len(found):
                verdict = "wrong"
            elif found:
                verdict = "isolated" if own in at_s else "ambiguous"
                delays.append(at_s.get(own, min(at_s.values())) - START_S)
            counts[verdict] += 1
    text = ", ".join(
        f"{counts[w]} {w}" for w in ("isolated", "ambiguous", "missed", "wrong") if counts[w]
    )
    return f"{text}; {np.median(delays):.1f} / {max(delays):.1f} s" if delays else text


def main() -> None:
    """Print the tables."""
    faults = dict.fromkeys(fault.name for row in FAULTS.values() for fault in row)
    for name in faults:
        cells = []
        for vehicle, row in FAULTS.items():
            own = [fault for fault in row if fault.name == name]
            cells.append(cell(vehicle, own) if own else "")
        print(f"| {name} | {' | '.join(cells)} |", flush=True)
    cells = []
    for vehicle in FAULTS:
        found = [isolated(vehicle, flown(vehicle, seed, GUSTY_S, None)) for seed in GUSTY_SEEDS]
        hours = len(GUSTY_SEEDS) * GUSTY_S / 3600.0
        cells.append(f"{sum(map(len, found))} isolated in {hours:.2f} h")
    print(f"| gusts alone | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()

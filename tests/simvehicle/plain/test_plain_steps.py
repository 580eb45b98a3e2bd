"""Plain steps give the same bytes as the simulation and the packer."""

import math
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, frame_payload
from simvehicle.hil.hil_frames import HilPacker
from simvehicle.plain import plain_arrays as k
from simvehicle.plain.plain_steps import PlainSteps, can_be_plain
from simvehicle.plain.step_kernel import command, look_ahead, step
from simvehicle.scenario.scenario_file import read_scenario
from simvehicle.simulation.simulation import Simulation
from simvehicle.vehicles.actuators import ARMED_FLAG, CHANNEL_COUNT, read_controls
from simvehicle.vehicles.body import Controls

ANSWER = message_layout("HIL_ACTUATOR_CONTROLS")
QUAD = """
name: plain
vehicle: {kind: multirotor, parameters: iris}
environment: {wind_ned_mps: [2, -1, 0], gusts: moderate, shear: {reference_m: 10, exponent: 0.14}}
sensors:
  imu: [{preset: consumer-mems, rate_hz: 300}, {preset: consumer-mems, rate_hz: 300, id: 1}]
  mag: {preset: consumer-mag, rate_hz: 50}
  baro: {preset: consumer-baro, rate_hz: 40, drift_pa_per_k: 2.0}
  gps: {preset: consumer, rate_hz: 5, latency_s: 0.11}
  battery: {rate_hz: 2}
"""
PLANE = """
name: plain
vehicle: {kind: fixedwing, parameters: NAME}
start: {height_m: 300}
environment: {gusts: light}
sensors:
  imu: {preset: consumer-mems, rate_hz: 250}
  mag: {preset: consumer-mag, rate_hz: 50, latency_s: 0.02}
  baro: {preset: consumer-baro, rate_hz: 50}
  gps: {preset: consumer, rate_hz: 5}
  airspeed: {preset: mpxv5004dp, rate_hz: 50}
"""
VEHICLES = {
    "quad": QUAD,
    "plane": PLANE.replace("NAME", "aerosonde-2025"),
    "plane without a motor model": PLANE.replace("NAME", "aerosonde-2025-thrust-law"),
}
STEPS = 1600  # over three blocks of random draws


def channels(number: int, kind: str) -> list[float]:
    """Possible commands of an autopilot at a step, some of them invalid."""
    draw = np.random.default_rng([7, number])
    values = [0.0] * CHANNEL_COUNT
    if kind == "quad":
        # Up, and around its axes a little.
        values[:4] = (0.72 + 0.02 * draw.standard_normal(4)).tolist()
    else:
        values[2:8] = (0.1 * draw.standard_normal(6)).tolist()
        values[4] = 0.6
    if number % 97 == 0:
        values[int(draw.integers(8))] = (math.nan, math.inf, -3.0, 3.0)[number % 4]
    return values


def answers(kind: str) -> Iterator[tuple[list[float], int]]:
    """The channels of each step and the mode: armed from the hundredth on."""
    for number in range(STEPS):
        yield channels(number, kind), ARMED_FLAG | 1 if number > 100 else 1


def flight(kind: str, folder: Path) -> Simulation:
    """A simulation of one of the vehicles."""
    path = folder / "plain.yaml"
    path.write_text(VEHICLES[kind])
    return Simulation(read_scenario(path), seed=3)


def read(simulation: Simulation, values: list[float], mode: int) -> Controls:
    """Read the controls of an answer as the loop does."""
    payload = struct.pack("<QQ16fB", 1, 0, *values, mode)
    raw = frame_payload(ANSWER, payload, seq=0, system=1, component=1)
    mix = simulation.kind.mix(simulation.vehicle)
    return read_controls(Frame(raw, ANSWER), mix)[1]


def ordinary(kind: str, folder: Path) -> tuple[list[bytes], Simulation]:
    """The frames of each step by the simulation and the packer."""
    simulation, hil, out = flight(kind, folder), HilPacker(), []
    for number, (values, mode) in enumerate(answers(kind)):
        if number == 700:
            simulation.plant(simulation.vehicle.plant_names[0], 0.1)
        result = simulation.step(read(simulation, values, mode))
        out.append(b"".join(hil.frames(*result)))
        simulation.prepare()
    return out, simulation


def plain(kind: str, folder: Path) -> tuple[list[bytes], Simulation, int]:
    """The same with plain steps wherever possible, and their number."""
    simulation, hil, out = flight(kind, folder), HilPacker(), []
    assert can_be_plain(simulation)
    steps = PlainSteps(simulation, hil)
    count, left, until_us, taken = 0, 0, 0, False
    for number, (values, mode) in enumerate(answers(kind)):
        if taken and (left == 0 or steps.arrays.words[k.NEXT_US] >= until_us or number == 700):
            steps.give_back()
            taken = False
        if number == 700:
            simulation.plant(simulation.vehicle.plant_names[0], 0.1)
        if not taken:
            until_us, left = steps.take()
            taken = left > 0 and steps.arrays.words[k.NEXT_US] < until_us
        if taken:
            arrays = steps.arrays
            arrays.words[k.ARMED] = mode & ARMED_FLAG
            command(arrays, np.array(values, dtype=np.float32))
            assert step(arrays)
            out.append(arrays.out[: arrays.words[k.LENGTH]].tobytes())
            look_ahead(arrays)
            count, left = count + 1, left - 1
            continue
        result = simulation.step(read(simulation, values, mode))
        out.append(b"".join(hil.frames(*result)))
        simulation.prepare()
    if taken:
        steps.give_back()
    return out, simulation, count


@pytest.mark.parametrize("kind", VEHICLES)
def test_plain_steps_give_the_same_bytes_as_ordinary_steps(kind: str, tmp_path: Path) -> None:
    expected, simulation = ordinary(kind, tmp_path)
    found, flown, count = plain(kind, tmp_path)
    assert found == expected
    # The plane's delayed 50 Hz compass needs ordinary steps, and each delayed reading another.
    assert count > (0.9 if kind == "quad" else 0.5) * STEPS
    for name in simulation.truth.__struct_fields__:
        np.testing.assert_array_equal(
            getattr(flown.truth, name), getattr(simulation.truth, name), err_msg=name
        )


def test_a_diverging_state_is_reported(tmp_path: Path) -> None:
    simulation = flight("plane", tmp_path)
    steps = PlainSteps(simulation, HilPacker())
    steps.take()
    steps.arrays.x[3] = math.nan
    assert not step(steps.arrays)
    with pytest.raises(ConfigError, match="simulation diverged"):
        steps.give_back()

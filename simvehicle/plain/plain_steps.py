"""Copies a simulation and its packer to arrays for plain steps, and the results back."""

import math
from itertools import islice
from operator import length_hint
from typing import Any, cast

import numpy as np

from mavproxy_fault.numerics.crc import SLICES, slicing_tables
from simvehicle.environment.terrain import LevelGround
from simvehicle.hil.hil_frames import HilPacker
from simvehicle.plain import plain_arrays as k
from simvehicle.plain.plain_arrays import Plain, new_arrays
from simvehicle.sensors.airspeed import Airspeed
from simvehicle.sensors.barometer import Barometer
from simvehicle.sensors.error_model import NoiseState
from simvehicle.sensors.imu import ImuSensor
from simvehicle.sensors.magnetometer import Magnetometer
from simvehicle.simulation.onboard_sensors import OnboardSensor
from simvehicle.simulation.simulation import LONGEST_STEP_S, Simulation, StepState
from simvehicle.simulation.weather import DRAW_BLOCK
from simvehicle.vehicles.body import Controls
from simvehicle.vehicles.fixedwing.fixedwing import FixedWing
from simvehicle.vehicles.multirotor.multirotor import Multirotor
from simvehicle.vehicles.vehicle import Vehicle

KINDS: dict[type, int] = {
    ImuSensor: k.IMU,
    Magnetometer: k.MAG,
    Barometer: k.BARO,
    Airspeed: k.PITOT,
}
FLYING = (Multirotor, FixedWing)


def can_be_plain(simulation: Simulation) -> bool:
    """Whether a flight has plain steps at all."""
    return isinstance(simulation.vehicle, FLYING) and isinstance(simulation.terrain, LevelGround)


class PlainSteps:
    """The plain steps of one flight; from `take` to `give_back` simulation and packer are paused.

    Attributes
    ----------
    arrays : Plain
        What `step_kernel` works on.
    """

    def __init__(self, simulation: Simulation, hil: HilPacker) -> None:
        assert can_be_plain(simulation)
        self._simulation, self._hil = simulation, hil
        fitted = simulation.onboard_sensors
        self._plain = [one for one in fitted if type(one.sensor) in KINDS and not one.latency_us]
        self._others = [one for one in fitted if one not in self._plain]
        self._taken: list[NoiseState] = []  # whose blocks the arrays hold
        noises = sum(len(_noises(one)) for one in self._plain)
        states = len(simulation.step_state().x)
        own = new_arrays(
            states, simulation.vehicle.controls_count, len(self._plain), noises, DRAW_BLOCK
        )
        weather = simulation.weather
        self._vehicle: Vehicle = simulation.vehicle
        self.arrays = Plain(
            **own,  # type: ignore[arg-type]
            home=simulation.packed_home,
            packed=cast(Multirotor | FixedWing, simulation.vehicle).packed,
            law=weather.law,
            filters=weather.filters,
            draws=weather.draws,
            crc=np.array(slicing_tables(), dtype=np.uint16).reshape(SLICES, 256),
        )
        self._describe()

    def _describe(self) -> None:
        words, numbers = self.arrays.words, self.arrays.numbers
        simulation, hil = self._simulation, self._hil
        words[k.FIXED_WING] = isinstance(simulation.vehicle, FixedWing)
        words[k.SYSTEM], words[k.COMPONENT] = hil.system, hil.component
        words[k.START_US] = hil.start_us
        numbers[k.LONGEST_S] = LONGEST_STEP_S
        numbers[k.RATE_HZ] = simulation.onboard_sensors[0].sensor.rate_hz
        numbers[k.GROUND_M] = cast(LevelGround, simulation.terrain).alt_m
        numbers[k.GEOID_M] = simulation.home.geoid_m
        noise = 0
        for at, fitted in enumerate(self._plain):
            sensor: Any = fitted.sensor
            row, gains = self.arrays.sensors[at], self.arrays.gains[at]
            row[k.KIND], row[k.ID], row[k.NOISE] = KINDS[type(sensor)], sensor.id, noise
            gains[k.SENSOR_HZ] = sensor.rate_hz
            if isinstance(sensor, ImuSensor):
                gains[k.SCALE], gains[k.LIMIT] = sensor.gyro.scale, sensor.gyro_range_rps
                gains[k.SCALE_2], gains[k.LIMIT_2] = sensor.accel.scale, sensor.accel_range_mps2
            else:
                gains[k.SCALE] = sensor.noise.scale
            if isinstance(sensor, Magnetometer):
                gains[k.FIELD : k.FIELD + 3] = sensor.field_ned_gauss
            elif isinstance(sensor, Barometer):
                gains[k.DRIFT] = sensor.drift_pa_per_k
            elif isinstance(sensor, Airspeed):
                row[k.ID] = 0  # HIL_SENSOR has one pitot tube
            noise += len(_noises(fitted))

    def take(self) -> tuple[int, int]:
        """Take over: the instant before which steps are plain [us], and how many at most."""
        simulation, hil, arrays = self._simulation, self._hil, self.arrays
        moment, truth = simulation.step_state(), simulation.truth
        words, numbers = arrays.words, arrays.numbers
        words[k.T_US], words[k.COUNT] = moment.t_us, moment.number
        words[k.NEXT_US], words[k.SUBSTEPS] = moment.next_us, moment.steps
        words[k.ROW], words[k.SEQ] = simulation.weather.row, hil.seq
        numbers[k.DT], numbers[k.AGL_M] = moment.dt, truth.height_agl_m
        arrays.x[:], arrays.wind[1], arrays.around[:] = moment.x, moment.wind, moment.surroundings
        arrays.fields[:] = hil.sensor_fields
        self._refit()
        left = min([DRAW_BLOCK - 1 - simulation.weather.row, *self._take_sensors()])
        ends: list[float] = [hil.heartbeat_us, *(one.due_us for one in self._others)]
        if simulation.delayed_readings:
            ends.append(simulation.delayed_readings[0][0])
        return math.ceil(min(ends)), left

    def _refit(self) -> None:
        """Use the new vehicle after a plant fault, and the weather's new draws after a block."""
        simulation = self._simulation
        draws = simulation.weather.draws
        if simulation.vehicle is not self._vehicle or draws is not self.arrays.draws:
            self._vehicle = simulation.vehicle
            packed = cast(Multirotor | FixedWing, self._vehicle).packed
            self.arrays = self.arrays._replace(packed=packed, draws=draws)

    def _take_sensors(self) -> list[int]:
        """Copy the sensors' state; return how many noise draws each has left."""
        arrays, left = self.arrays, []
        noises = [noise for fitted in self._plain for noise in _noises(fitted)]
        for at, noise in enumerate(noises):
            # Most often the block is the same, and only its row another.
            if not self._taken or noise.block is not self._taken[at].block:
                arrays.noise[at, :, : noise.block.shape[1]] = noise.block
            left.append(length_hint(noise.rows))
        self._taken = noises
        for at, fitted in enumerate(self._plain):
            row = arrays.sensors[at]
            row[k.SAMPLES], row[k.AT] = fitted.count, DRAW_BLOCK - left[row[k.NOISE]]
            arrays.gains[at, k.DUE_US] = fitted.due_us
        return left

    def observe(self) -> None:
        """Set the simulation's truth to the state after the last step.

        Raises
        ------
        ConfigError
            If it has left the numbers.
        """
        arrays = self.arrays
        t_us = int(arrays.words[k.T_US])
        load, wind = arrays.load.copy(), arrays.wind[0].copy()
        self._simulation.adopt_state(t_us, arrays.x.copy(), load, wind)

    def give_back(self) -> Controls:
        """Resume simulation and packer from here; return the current commands."""
        simulation, hil, arrays = self._simulation, self._hil, self.arrays
        self.observe()
        t_us, count, next_us, steps, row, *_ = arrays.words.tolist()
        hil.seq, hil.step_us = int(arrays.words[k.SEQ]), t_us + hil.start_us
        hil.sensor_fields = arrays.fields.tolist()
        simulation.weather.row = row
        ahead = (next_us, steps, float(arrays.numbers[k.DT]))
        wind, around, controls = arrays.wind[1], arrays.around, arrays.controls.copy()
        simulation.resume_from(
            StepState(t_us, arrays.x, count, *ahead, wind.copy(), around.copy()), controls
        )
        for at, fitted in enumerate(self._plain):
            self._give_back_sensor(at, fitted)
        return Controls(controls, armed=bool(arrays.words[k.ARMED]))

    def _give_back_sensor(self, at: int, fitted: OnboardSensor) -> None:
        count = int(self.arrays.sensors[at, k.SAMPLES])
        for noise in _noises(fitted):
            for _ in islice(noise.rows, count - fitted.count):
                pass
        fitted.count, fitted.due_us = count, float(self.arrays.gains[at, k.DUE_US])


def _noises(fitted: OnboardSensor) -> list[NoiseState]:
    """The noise of a plain sensor, one or two."""
    state = fitted.state
    return [state] if isinstance(state, NoiseState) else list(state)

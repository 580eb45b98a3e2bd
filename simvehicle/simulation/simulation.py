"""The simulation of one flight: vehicle, weather, sensors, and the built-in controller.

Time is simulated; nothing here reads a clock or does I/O. The same scenario and seed give the same
readings, and each part has its own random stream, so adding a sensor changes no other.
"""

import heapq
import itertools
import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.numerics.rotations.rotation import quat_from_euler
from simvehicle.environment.geolocation import (
    AIR,
    AIR_VELOCITY,
    ATTITUDE,
    LOCAL_GRAVITY,
    LOCATION_SIZE,
    VELOCITY,
    HomeFrame,
    locate_state,
)
from simvehicle.environment.terrain import LevelGround, TerrainGrid, read_terrain_grid
from simvehicle.guidance.mission import plan_path
from simvehicle.guidance.open_loop_controller import OpenLoopController
from simvehicle.guidance.route import PathTrack
from simvehicle.guidance.sway_controller import SwayController
from simvehicle.scenario.scenario_file import Scenario
from simvehicle.sensors.airspeed import Airspeed
from simvehicle.sensors.readings import Reading
from simvehicle.simulation.onboard_sensors import OnboardSensor, create_onboard_sensors
from simvehicle.simulation.vehicle_kinds import Controller, find_vehicle_kind
from simvehicle.simulation.weather import Weather
from simvehicle.vehicles.body import Controls, Truth
from simvehicle.vehicles.fixedwing.fixedwing import FixedWing
from simvehicle.vehicles.multirotor.multirotor import Multirotor
from simvehicle.vehicles.rigidbody_kernel import DOWN, RIGID_SIZE, P, U
from simvehicle.vehicles.vehicle import VOLTS, pack_surroundings

Array = NDArray[np.float64]
LONGEST_STEP_S = 0.005  # ground contact is stiff: 40 rad/s needs steps of a few ms
_WIND_PLANT_NAMES = ("wind_n_mps", "wind_e_mps", "wind_d_mps")


class StepState(NamedTuple):
    """State of a flight and the precomputed inputs of its next step; see `Simulation.step`."""

    t_us: int
    x: Array
    number: int  # the next step's number
    next_us: int
    steps: int
    dt: float
    wind: Array
    surroundings: Array


class Simulation:
    """A flight simulated step by step, at the rate of the first IMU.

    Attributes
    ----------
    scenario : Scenario
    terrain : Grid or Level
    home : Home
        Origin of the local frame, on the ground.
    kind, vehicle, controller
        The vehicle with its kind, and the controller for steps without controls. The controller's
        `track` may be replaced in flight.
    truth : Truth
        The truth of the last step.
    weather, onboard_sensors, delayed_readings, packed_home
        The wind, the sensors on board, a heap of readings by delivery time, and the home frame as
        `locate_state` takes it.
    """

    def __init__(self, scenario: Scenario, seed: int | None = None) -> None:
        self.terrain = _load_terrain(scenario)
        scenario = _with_home_on_terrain(scenario, self.terrain)
        self.scenario = scenario
        self.seed = scenario.seed if seed is None else seed
        start = scenario.start
        self.home = HomeFrame.at(start.lat_deg, start.lon_deg, start.alt_m, start.geoid_m)
        self.kind = find_vehicle_kind(scenario.vehicle.kind)
        self.vehicle = self.kind.read(scenario.vehicle.parameters)
        self._plant: dict[str, float] = {}
        self.weather = Weather(scenario.environment, self.seed)
        self.onboard_sensors = create_onboard_sensors(scenario, self.seed)
        self._rate_hz = self.onboard_sensors[0].sensor.rate_hz
        self._count = 0
        self._t_us = 0
        # A heap by delivery time, then in the order of sampling.
        self.delayed_readings: list[tuple[int, int, Reading]] = []
        self._order = itertools.count()
        self._controls = np.zeros(self.vehicle.controls_count)
        self._commands = self._controls
        self.packed_home = self.home.packed
        self._x = self._initial_state()
        # Before the first step, the specific force and battery of the truth are zero.
        self.truth = self._observe(np.zeros(6), self.weather.steady_mps.copy())
        # Created after the first truth, as its gains depend on the air density.
        self.controller = self._controller()
        self._next_control_us = 0.0
        self._ahead: tuple[int, int, float, Array, Array] | None = None
        if scenario.mission:
            self.controller.track = self._mission()

    @property
    def controls(self) -> Array:
        """The actuator commands of the last step, in the vehicle's order."""
        return self._controls

    def commanded(self) -> Array:
        """The built-in controller's commands for the next step, in the vehicle's order."""
        if self._t_us >= self._next_control_us:
            self._commands = self.controller.update(self.truth).values
            # Accumulated, so that the mean rate is right even if steps do not divide the period.
            self._next_control_us += 1e6 / self.controller.rate_hz
        return self._commands

    def step(self, controls: Controls | None = None) -> tuple[int, Truth, list[Reading]]:
        """Advance to the next sample of the IMU.

        Parameters
        ----------
        controls : Controls, optional
            External controls, for example an autopilot's; without them the controller flies.

        Returns
        -------
        t_us : int
            Time since the start of the simulation, above 0.
        truth : Truth
        readings : list of Reading
            The readings delivered at this step; the IMU's comes first.
        """
        self._controls = self.commanded() if controls is None else self._checked(controls)
        self._t_us, steps, dt, wind, surroundings = self._ahead or self._next_inputs()
        self._ahead = None
        self._x, load = self.vehicle.advance(self._x, self._controls, surroundings, steps, dt)
        self.truth = self._observe(load, wind)
        return self._t_us, self.truth, self._read()

    def prepare(self) -> None:
        """Compute the inputs of the next step that do not depend on its controls; a change of the
        wind then takes effect one step later."""
        self._ahead = self._ahead or self._next_inputs()

    def step_state(self) -> StepState:
        """The state now, with the inputs of the next step."""
        self.prepare()
        assert self._ahead is not None
        return StepState(self._t_us, self._x, self._count, *self._ahead)

    def adopt_state(self, t_us: int, x: Array, load: Array, wind: Array) -> Truth:
        """Adopt a state that was computed elsewhere, with its load (6,) and wind (3,).

        Raises
        ------
        ConfigError
            If the state is not finite.
        """
        self._t_us, self._x = t_us, x
        self.truth = self._observe(load, wind)
        return self.truth

    def resume_from(self, state: StepState, controls: Array) -> None:
        """Continue after steps that were computed elsewhere; call it after `adopt_state`."""
        self._count, self._ahead, self._controls = state.number, state[3:], controls

    def _next_inputs(self) -> tuple[int, int, float, Array, Array]:
        """The next step's end [us], its number of substeps and their length [s], wind and
        surroundings."""
        self._count += 1
        # From the count: summing a period of 3.33 ms would drift.
        t_us = round(self._count * 1e6 / self._rate_hz)
        dt = (t_us - self._t_us) * 1e-6
        truth = self.truth
        # Constant over the step, as gusts are slow in comparison.
        wind = self.weather.wind(self._x, truth, dt)
        ground_down_m = float(self._x[DOWN]) + truth.height_agl_m
        surroundings = pack_surroundings(wind, self._gravity, truth.density_kgpm3, ground_down_m)
        # Divide long steps, so that a slow IMU does not make the integration coarse.
        steps = max(1, math.ceil(dt / LONGEST_STEP_S - 1e-9))
        return t_us, steps, dt / steps, wind, surroundings

    def _checked(self, controls: Controls) -> Array:
        values = controls.values
        count = self.vehicle.controls_count
        if len(values) != count or not math.isfinite(sum(values.tolist())):
            raise ConfigError(
                f"controls: {values.tolist()} at {self._t_us * 1e-6:.3f} s cannot be used; "
                f"{count} finite numbers are needed"
            )
        return values if controls.armed else np.zeros(count)

    def plant(self, name: str, value: float | None) -> None:
        """Set a plant fault, or remove it with None.

        Names: the vehicle's `plant_names`, `wind_n_mps`, `wind_e_mps`, `wind_d_mps`, and those of
        the GNSS sensor.

        Raises
        ------
        ConfigError
            If the name is unknown or the value is impossible.
        """
        if name in _WIND_PLANT_NAMES:
            axis = _WIND_PLANT_NAMES.index(name)
            healthy = self.scenario.environment.wind_ned_mps[axis]
            self.weather.steady_mps[axis] = healthy if value is None else value
        elif name in self.vehicle.plant_names:
            # Rebuilt from all active faults, so that their order has no effect.
            changed = {k: v for k, v in self._plant.items() if k != name}
            if value is not None:
                changed[name] = value
            try:
                self.vehicle = self.vehicle.with_plant(changed)
            except ValueError as error:
                raise ConfigError(f"plant: {name} = {value} is impossible; {error}") from None
            self._plant = changed
        else:
            self._satellite_plant(name, value)

    def check_plant(self, name: str) -> None:
        """Refuse a plant fault that this simulation does not support; changes nothing.

        Raises
        ------
        ConfigError
            Lists the supported names.
        """
        if name not in (*_WIND_PLANT_NAMES, *self.vehicle.plant_names):
            self._with_satellite_plant(name, None)

    def pitot_offset_pa(self) -> float | None:
        """The pitot tube's offset in still air [Pa], as a preflight calibration measures it; None
        without a pitot tube."""
        for fitted in self.onboard_sensors:
            if isinstance(fitted.sensor, Airspeed):
                return float(fitted.state.bias[0] + fitted.state.drift[0])
        return None

    def _satellite_plant(self, name: str, value: float | None) -> None:
        fitted, state = self._with_satellite_plant(name, value)
        fitted.state = state

    def _with_satellite_plant(self, name: str, value: float | None) -> tuple[OnboardSensor, Any]:
        """The GNSS sensor, and its state with one plant fault set."""
        for fitted in self.onboard_sensors:
            sensor: Any = fitted.sensor
            if hasattr(sensor, "with_plant"):
                return fitted, sensor.with_plant(fitted.state, name, value)
        known = ", ".join((*self.vehicle.plant_names, *_WIND_PLANT_NAMES))
        raise ConfigError(f"plant: {name} is unknown; known: {known}")

    def _initial_state(self) -> Array:
        """The vehicle's initial state: trimmed flight in the air, or standing on the ground."""
        start, scenario = self.scenario.start, self.scenario
        heading = math.radians(start.heading_deg)
        vehicle = self.vehicle
        zero = np.zeros(3)
        # A placeholder until the position has been located.
        self._gravity = np.array([0.0, 0.0, 9.81])
        if start.height_m == 0.0:
            height = vehicle.standing_height_m
            return vehicle.start(
                np.array([0.0, 0.0, -height]), zero, quat_from_euler(0.0, 0.0, heading)
            )
        r = np.array([0.0, 0.0, -start.height_m])
        if start.state is not None:
            s = start.state
            q_nb = quat_from_euler(math.radians(s.roll_deg), math.radians(s.pitch_deg), heading)
            x = vehicle.start(r, np.array([s.u_mps, s.v_mps, s.w_mps]), q_nb)
            x[P:RIGID_SIZE] = np.radians([s.p_dps, s.q_dps, s.r_dps])
            if isinstance(vehicle, Multirotor):
                x[RIGID_SIZE:-2] = vehicle.hover_rps(*self._air_and_gravity(x))
            return x
        level = vehicle.start(r, zero, quat_from_euler(0.0, 0.0, heading))
        density, pull = self._air_and_gravity(level)
        speeds = [leg.speed_mps or vehicle.parameters.cruise_mps for leg in scenario.mission]
        states, wind = [], self.weather.steady_mps
        for number, speed in enumerate(speeds or [vehicle.parameters.cruise_mps]):
            try:
                # Check all legs now: a mission must not fail in the air.
                states.append(vehicle.cruise(r, heading, wind, speed, density, pull))
            except ValueError as error:
                raise ConfigError(
                    f"mission[{number}].speed_mps = {speed:g} cannot be flown; {error}"
                ) from None
        return states[0]

    def _air_and_gravity(self, x: Array) -> tuple[float, float]:
        """Air density [kg/m^3] and gravity [m/s^2] at a state's position."""
        location = np.empty(LOCATION_SIZE)
        locate_state(x, np.zeros(3), self.packed_home, location)
        self._gravity = location[LOCAL_GRAVITY:]
        return float(location[AIR + 2]), float(np.linalg.norm(self._gravity))

    def _controller(self) -> Controller:
        scenario, density = self.scenario, self.truth.density_kgpm3
        if scenario.controls is None:
            return self.kind.controller(self.vehicle, density, scenario.start.alt_m)
        if isinstance(self.vehicle, Multirotor):
            weave = scenario.controls.weave
            assert weave is not None  # as `Scenario` checks
            aim = (math.radians(weave.roll_deg), weave.period_s, math.radians(weave.pitch_deg))
            try:
                return SwayController(self.vehicle, scenario.start.alt_m, aim)
            except ValueError as error:
                raise ConfigError(f"controls.weave: {error}") from None
        assert isinstance(self.vehicle, FixedWing)  # as `Scenario` checks
        return OpenLoopController(self.vehicle, density, scenario.start.alt_m, scenario.controls)

    def _mission(self) -> PathTrack:
        scenario, controller = self.scenario, self.controller
        north_mps, east_mps, _ = self.weather.steady_mps.tolist()
        path = plan_path(
            scenario.mission,
            (float(self._x[0]), float(self._x[1]), math.radians(scenario.start.heading_deg)),
            self.vehicle.parameters.cruise_mps,
            # The corners are rounded for a downwind turn, the widest.
            math.hypot(north_mps, east_mps) if controller.drifts else 0.0,
            controller.lateral_mps2,
        )
        return PathTrack(path)

    def _observe(self, load: Array, wind: Array) -> Truth:
        """The truth of the current state."""
        x, location = self._x, np.empty(LOCATION_SIZE)
        locate_state(x, wind, self.packed_home, location)
        lat, lon, height, pressure, temperature, density = location[:VELOCITY].tolist()
        # The height depends on the whole state, so it reveals any divergence.
        if not math.isfinite(height):
            raise ConfigError(
                f"the simulation diverged at {self._t_us * 1e-6:.3f} s; check the vehicle's "
                "parameters, controls and plant faults"
            )
        self._gravity = location[LOCAL_GRAVITY:]
        alt = height - self.home.geoid_m
        agl = alt - self.terrain.ground(lat, lon)
        volts, amperes, charge = load[VOLTS:].tolist()
        return Truth(
            self._t_us,
            lat,
            lon,
            height,
            alt,
            agl,
            x[:U],
            location[VELOCITY:ATTITUDE],
            location[ATTITUDE:AIR_VELOCITY],
            x[P:RIGID_SIZE],
            load[:VOLTS],
            location[AIR_VELOCITY:LOCAL_GRAVITY],
            wind,
            pressure,
            temperature,
            density,
            volts,
            amperes,
            charge,
            agl < self.vehicle.standing_height_m + 0.02,
        )

    def _read(self) -> list[Reading]:
        """The readings delivered at this step, including delayed ones."""
        truth, t_us = self.truth, self._t_us
        out: list[Reading] = []
        for fitted in self.onboard_sensors:
            if t_us < fitted.due_us:
                continue
            if fitted.latency_us == 0:
                out += fitted.sample(truth)
                continue
            for reading in fitted.sample(truth):
                # The counter orders readings of the same time, as readings cannot be compared.
                heapq.heappush(
                    self.delayed_readings, (t_us + fitted.latency_us, next(self._order), reading)
                )
        while self.delayed_readings and self.delayed_readings[0][0] <= t_us:
            # Stamped at delivery: the link does not reveal the age of a measurement.
            out.append(msgspec.structs.replace(heapq.heappop(self.delayed_readings)[2], t_us=t_us))
        return out


def simulate_flight(
    scenario: Scenario, seed: int | None = None
) -> Iterator[tuple[int, Truth, list[Reading]]]:
    """Simulate a scenario from start to end with the built-in controller.

    Yields
    ------
    t_us, truth, readings
        At each sample of the IMU.
    """
    simulation = Simulation(scenario, seed)
    end_us = round(scenario.duration_s * 1e6)
    while True:
        step = simulation.step()
        if step[0] > end_us:
            return
        yield step


def _load_terrain(scenario: Scenario) -> TerrainGrid | LevelGround:
    path = scenario.environment.terrain
    return read_terrain_grid(path) if path is not None else LevelGround(scenario.start.alt_m)


def _with_home_on_terrain(scenario: Scenario, terrain: TerrainGrid | LevelGround) -> Scenario:
    """The scenario with home at the height of the terrain."""
    start = scenario.start
    alt = terrain.ground(math.radians(start.lat_deg), math.radians(start.lon_deg))
    return msgspec.structs.replace(scenario, start=msgspec.structs.replace(start, alt_m=alt))

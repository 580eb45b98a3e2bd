"""One flight: the vehicle in its air, the sensors on board, the controller or someone else's.

Time is simulated; nothing here reads a clock or does I/O. The same scenario and seed give the same
readings, and each part draws from a stream of its own, so adding a sensor changes no other.
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
LONGEST_STEP_S = 0.005  # a ground contact is stiff
_WIND_PLANT_NAMES = ("wind_n_mps", "wind_e_mps", "wind_d_mps")


class StepState(NamedTuple):
    """Where a flight stands, and what is known ahead of its next step; see `Simulation.step`."""

    t_us: int
    x: Array
    number: int  # the next step's number
    next_us: int
    steps: int
    dt: float
    wind: Array
    around: Array


class Simulation:
    """A flight that goes on step by step, at the rate of the first inertial unit.

    Attributes
    ----------
    scenario : Scenario
    terrain : Grid or Level
    home : Home
        Origin of the local frame, on the ground.
    kind, vehicle, controller
        Its kind, what flies, and what flies it when `step` gets no controls. The controller's
        `track` may be replaced in flight.
    truth : Truth
        The last one.
    weather, fitted, late, place
        The wind, the sensors on board, readings to come by their times, and home as `locate_state`
        takes it.
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
        # A heap by the time of delivery, then in the order of sampling.
        self.delayed_readings: list[tuple[int, int, Reading]] = []
        self._order = itertools.count()
        self._controls = np.zeros(self.vehicle.controls_count)
        self._commands = self._controls
        self.packed_home = self.home.packed
        self._x = self._begin()
        # No step has been made: specific force and battery of this first truth are zero.
        self.truth = self._observe(np.zeros(6), self.weather.steady_mps.copy())
        # After the first truth, as its gains are made for the air density there.
        self.controller = self._controller()
        self._next_control_us = 0.0
        self._ahead: tuple[int, int, float, Array, Array] | None = None
        if scenario.mission:
            self.controller.track = self._mission()

    @property
    def controls(self) -> Array:
        """The actuator commands now in force, in the vehicle's order."""
        return self._controls

    def commanded(self) -> Array:
        """What the built-in controller commands for the next step, in the vehicle's order."""
        if self._t_us >= self._next_control_us:
            self._commands = self.controller.update(self.truth).values
            # Added up, not counted from now: the mean rate is right where steps do not divide it.
            self._next_control_us += 1e6 / self.controller.rate_hz
        return self._commands

    def step(self, controls: Controls | None = None) -> tuple[int, Truth, list[Reading]]:
        """Go on to the next sample of the inertial unit.

        Parameters
        ----------
        controls : Controls, optional
            Someone else's, for example an autopilot's; without them the controller flies.

        Returns
        -------
        t_us : int
            Since the start of the simulation, above 0.
        truth : Truth
        readings : list of Reading
            What the sensors delivered by now; the inertial unit's comes first.
        """
        self._controls = self.commanded() if controls is None else self._checked(controls)
        self._t_us, steps, dt, wind, around = self._ahead or self._outside()
        self._ahead = None
        self._x, load = self.vehicle.advance(self._x, self._controls, around, steps, dt)
        self.truth = self._observe(load, wind)
        return self._t_us, self.truth, self._read()

    def prepare(self) -> None:
        """Reckon what of the next step no controls change, while they are still awaited; the wind
        is then settled, and a change of it comes a step later."""
        self._ahead = self._ahead or self._outside()

    def step_state(self) -> StepState:
        """Where it stands now."""
        self.prepare()
        assert self._ahead is not None
        return StepState(self._t_us, self._x, self._count, *self._ahead)

    def adopt_state(self, t_us: int, x: Array, load: Array, wind: Array) -> Truth:
        """Take over a state that was reached elsewhere, under a load (6,) and in a wind (3,).

        Raises
        ------
        ConfigError
            If the state has left the numbers.
        """
        self._t_us, self._x = t_us, x
        self.truth = self._observe(load, wind)
        return self.truth

    def resume_from(self, moment: StepState, controls: Array) -> None:
        """Go on where steps that were flown elsewhere ended, after `adopt_state`."""
        self._count, self._ahead, self._controls = moment.number, moment[3:], controls

    def _outside(self) -> tuple[int, int, float, Array, Array]:
        """When the next step ends, into how many of how many seconds it is cut, the wind meanwhile,
        and `pack_surroundings`."""
        self._count += 1
        # From the count: 3 ms and a third, summed up, would drift.
        t_us = round(self._count * 1e6 / self._rate_hz)
        dt = (t_us - self._t_us) * 1e-6
        truth = self.truth
        # Held over the whole step: gusts are slow against it.
        wind = self.weather.wind(self._x, truth, dt)
        ground_down_m = float(self._x[DOWN]) + truth.height_agl_m
        around = pack_surroundings(wind, self._gravity, truth.density_kgpm3, ground_down_m)
        # Slow sensors must not make the integration coarse.
        steps = max(1, math.ceil(dt / LONGEST_STEP_S - 1e-9))
        return t_us, steps, dt / steps, wind, around

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
        """Switch a plant fault on, or off with None.

        Names: the vehicle's `plant_names`, `wind_n_mps`, `wind_e_mps`,
        `wind_d_mps`, and those of the satellite sensor.

        Raises
        ------
        ConfigError
            If the name is unknown or the value makes no vehicle.
        """
        if name in _WIND_PLANT_NAMES:
            axis = _WIND_PLANT_NAMES.index(name)
            healthy = self.scenario.environment.wind_ned_mps[axis]
            self.weather.steady_mps[axis] = healthy if value is None else value
        elif name in self.vehicle.plant_names:
            # Built anew from all faults that act: the order in which they came does not matter.
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
        """Refuse a plant fault that this simulation cannot have; nothing is changed.

        Raises
        ------
        ConfigError
            With what it can have.
        """
        if name not in (*_WIND_PLANT_NAMES, *self.vehicle.plant_names):
            self._with_satellite_plant(name, None)

    def pitot_offset_pa(self) -> float | None:
        """What the pitot tube shows without wind, as who calibrates it before a flight finds it;
        None without one."""
        for fitted in self.onboard_sensors:
            if isinstance(fitted.sensor, Airspeed):
                return float(fitted.state.bias[0] + fitted.state.drift[0])
        return None

    def _satellite_plant(self, name: str, value: float | None) -> None:
        fitted, state = self._with_satellite_plant(name, value)
        fitted.state = state

    def _with_satellite_plant(self, name: str, value: float | None) -> tuple[OnboardSensor, Any]:
        """The sensor that receives satellites, and its state with one of its parameters set."""
        for fitted in self.onboard_sensors:
            sensor: Any = fitted.sensor
            if hasattr(sensor, "with_plant"):
                return fitted, sensor.with_plant(fitted.state, name, value)
        known = ", ".join((*self.vehicle.plant_names, *_WIND_PLANT_NAMES))
        raise ConfigError(f"plant: {name} is unknown; known: {known}")

    def _begin(self) -> Array:
        """The vehicle's first state: trimmed flight at height, or standing on the ground."""
        start, scenario = self.scenario.start, self.scenario
        heading = math.radians(start.heading_deg)
        vehicle = self.vehicle
        zero = np.zeros(3)
        # Where nothing is computed yet; the first look at the place puts the real one in.
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
                x[RIGID_SIZE:-2] = vehicle.hover_rps(*self._around(x))
            return x
        level = vehicle.start(r, zero, quat_from_euler(0.0, 0.0, heading))
        density, pull = self._around(level)
        speeds = [leg.speed_mps or vehicle.parameters.cruise_mps for leg in scenario.mission]
        states, wind = [], self.weather.steady_mps
        for number, speed in enumerate(speeds or [vehicle.parameters.cruise_mps]):
            try:
                # All legs are tried now: a mission that cannot be flown must not fail in the air.
                states.append(vehicle.cruise(r, heading, wind, speed, density, pull))
            except ValueError as error:
                raise ConfigError(
                    f"mission[{number}].speed_mps = {speed:g} cannot be flown; {error}"
                ) from None
        return states[0]

    def _around(self, x: Array) -> tuple[float, float]:
        """Density of the air [kg/m^3] and gravity [m/s^2] where a state is."""
        place = np.empty(LOCATION_SIZE)
        locate_state(x, np.zeros(3), self.packed_home, place)
        self._gravity = place[LOCAL_GRAVITY:]
        return float(place[AIR + 2]), float(np.linalg.norm(self._gravity))

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
            # A turn flown downwind is the widest; the corners are rounded for it.
            math.hypot(north_mps, east_mps) if controller.drifts else 0.0,
            controller.lateral_mps2,
        )
        return PathTrack(path)

    def _observe(self, load: Array, wind: Array) -> Truth:
        """The truth of the state now."""
        x, place = self._x, np.empty(LOCATION_SIZE)
        locate_state(x, wind, self.packed_home, place)
        lat, lon, height, pressure, temperature, density = place[:VELOCITY].tolist()
        # The height depends on all the rest, so that it shows any divergence.
        if not math.isfinite(height):
            raise ConfigError(
                f"the simulation left the numbers at {self._t_us * 1e-6:.3f} s; the vehicle's "
                "parameters, controls or faults let it diverge"
            )
        self._gravity = place[LOCAL_GRAVITY:]
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
            place[VELOCITY:ATTITUDE],
            place[ATTITUDE:AIR_VELOCITY],
            x[P:RIGID_SIZE],
            load[:VOLTS],
            place[AIR_VELOCITY:LOCAL_GRAVITY],
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
        """Readings delivered by now, late ones of earlier samples included."""
        truth, t_us = self.truth, self._t_us
        out: list[Reading] = []
        for fitted in self.onboard_sensors:
            if t_us < fitted.due_us:
                continue
            if fitted.latency_us == 0:
                out += fitted.sample(truth)
                continue
            for reading in fitted.sample(truth):
                # The number keeps readings of one time in order: a heap cannot compare readings.
                heapq.heappush(
                    self.delayed_readings, (t_us + fitted.latency_us, next(self._order), reading)
                )
        while self.delayed_readings and self.delayed_readings[0][0] <= t_us:
            # Stamped at delivery: nobody on the link can see how old the measurement is.
            out.append(msgspec.structs.replace(heapq.heappop(self.delayed_readings)[2], t_us=t_us))
        return out


def simulate_flight(
    scenario: Scenario, seed: int | None = None
) -> Iterator[tuple[int, Truth, list[Reading]]]:
    """Fly a scenario from start to end with the built-in controller.

    Yields
    ------
    t_us, truth, readings
        At each sample of the inertial unit.
    """
    simulation = Simulation(scenario, seed)
    end_us = round(scenario.duration_s * 1e6)
    while True:
        found = simulation.step()
        if found[0] > end_us:
            return
        yield found


def _load_terrain(scenario: Scenario) -> TerrainGrid | LevelGround:
    path = scenario.environment.terrain
    return read_terrain_grid(path) if path is not None else LevelGround(scenario.start.alt_m)


def _with_home_on_terrain(scenario: Scenario, terrain: TerrainGrid | LevelGround) -> Scenario:
    """The scenario with home on the terrain."""
    start = scenario.start
    alt = terrain.ground(math.radians(start.lat_deg), math.radians(start.lon_deg))
    return msgspec.structs.replace(scenario, start=msgspec.structs.replace(start, alt_m=alt))

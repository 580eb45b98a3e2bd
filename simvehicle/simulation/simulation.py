"""The simulation of one flight: vehicle, weather, sensors, and the built-in controller.

Time is simulated; nothing here reads a clock or does I/O. The same scenario and seed give the same
readings, and each part has its own random stream, so adding a sensor changes no other.
"""

import heapq
import itertools
import math
from typing import Any

import msgspec
import numpy as np

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.numerics.arrays import Array
from mavproxy_fault.numerics.rotations.rotation import quat_from_euler
from mavproxy_fault.wire.plant_names import COMPASS, RECEIVER, SENSORS, SIGNALS, WIND
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
from simvehicle.environment.terrain import TerrainGrid, read_terrain_grid
from simvehicle.guidance.mission import plan_path
from simvehicle.guidance.open_loop_controller import OpenLoopController
from simvehicle.guidance.route import PathTrack
from simvehicle.guidance.sway_controller import SwayController
from simvehicle.scenario.scenario_file import Scenario
from simvehicle.sensors.compiled_sensor import PITOT
from simvehicle.sensors.flight_record import (
    FLIGHT,
    MAX_CONTROLS,
    MAX_STATES,
    Board,
)
from simvehicle.sensors.readings import Reading
from simvehicle.simulation import step_kernel
from simvehicle.simulation.onboard_sensors import OnboardSensor, create_onboard_sensors
from simvehicle.simulation.vehicle_kinds import Controller, find_vehicle_kind
from simvehicle.simulation.weather import Weather
from simvehicle.vehicles.body import Controls, Truth
from simvehicle.vehicles.fixedwing.fixedwing import FixedWing
from simvehicle.vehicles.multirotor.multirotor import Multirotor
from simvehicle.vehicles.rigidbody_kernel import RIGID_SIZE, P, U
from simvehicle.vehicles.vehicle import VOLTS

NEVER_US = 2**62  # of an event that never comes


class Simulation:
    """A flight simulated step by step, at the rate of the first IMU.

    Attributes
    ----------
    scenario : Scenario
    terrain : TerrainGrid or None
        None on level ground.
    home : Home
        Origin of the local frame, on the ground.
    kind, vehicle, controller
        The vehicle with its kind, and the controller for steps without controls. The controller's
        `track` may be replaced in flight.
    truth : Truth
        The truth of the last step.
    weather, compiled_sensors, onboard_sensors
        The wind, and the sensors on board.
    board : Board
        The state of the flight, for compiled code.
    """

    def __init__(self, scenario: Scenario, seed: int | None = None) -> None:
        file = scenario.environment.terrain
        self.terrain = read_terrain_grid(file) if file is not None else None
        if self.terrain is not None:
            scenario = _with_home_on_terrain(scenario, self.terrain)
        self.scenario = scenario
        self.seed = scenario.seed if seed is None else seed
        start = scenario.start
        self.home = HomeFrame.at(start.lat_deg, start.lon_deg, start.alt_m, start.geoid_m)
        self.kind = find_vehicle_kind(scenario.vehicle.kind)
        self.vehicle = self.kind.read(scenario.vehicle.parameters)
        self._plant: dict[str, float] = {}
        self.compiled_sensors, self.onboard_sensors, records = create_onboard_sensors(
            scenario, self.seed
        )
        self._late = [fitted for fitted in self.compiled_sensors if fitted.latency_us]
        self.board = Board(np.zeros(1, dtype=FLIGHT), records)
        self._flight: Any = self.board.flight[0]
        self.weather = Weather(scenario.environment, self.seed, self._flight)
        # A heap by delivery time, then in the order of sampling: readings, and records' values.
        self._delayed: list[tuple[int, int, Any]] = []
        self._order = itertools.count()
        self._commands = np.zeros(self.vehicle.controls_count)
        self._describe()
        # Before the first step, the specific force and battery of the truth are zero.
        self.observe(finite=step_kernel.locate(self.board.flight))
        # Created after the first truth, as its gains depend on the air density.
        self.controller = self._controller()
        self._next_control_us = 0.0
        if scenario.mission:
            self.controller.track = self._mission()

    def _describe(self) -> None:
        """Fill in the flight's record."""
        flight, controls = self._flight, self.vehicle.controls_count
        flight["rate_hz"], flight["count"] = self.compiled_sensors[0].sensor.rate_hz, 1
        flight["home"], flight["wind"] = self.home.packed, self.weather.steady_mps
        flight["ground_m"] = self.scenario.start.alt_m
        flight["wing"], flight["actuators"] = type(self.vehicle) is FixedWing, controls
        x = self._initial_state()
        if len(x) > MAX_STATES or controls > MAX_CONTROLS:
            raise ConfigError(
                f"vehicle.kind = {self.scenario.vehicle.kind} has {len(x)} states and {controls} "
                f"controls; at most {MAX_STATES} and {MAX_CONTROLS} are supported"
            )
        flight["states"] = len(x)
        # Views, for speed
        self._x, self._load, self._here = flight["x"][: len(x)], flight["load"], flight["here"]
        self._controls = flight["controls"][:controls]
        self._x[:] = x

    @property
    def controls(self) -> Array:
        """The actuator commands of the last step, in the vehicle's order."""
        flown: Array = self._controls.copy()
        return flown

    @property
    def packed(self) -> Array | None:
        """The vehicle's parameters for compiled code; None for a kind of another package."""
        vehicle: Any = self.vehicle
        return vehicle.packed if type(vehicle) in (FixedWing, Multirotor) else None

    def commanded(self) -> Array:
        """The built-in controller's commands for the next step, in the vehicle's order."""
        if self.truth.t_us >= self._next_control_us:
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
            The readings delivered at this step, except those in `board.sensors`.
        """
        self._controls[:] = self.commanded() if controls is None else self._checked(controls)
        self.prepare()
        flight, sensors = self.board
        if (packed := self.packed) is not None:
            finite = step_kernel.step(flight, sensors, packed)
        else:
            now = self._flight
            self._x[:], self._load[:] = self.vehicle.advance(
                self._x.copy(), self._controls, now["around"], int(now["substeps"]), now["dt"]
            )
            finite = step_kernel.arrive(flight, sensors)
        truth = self.observe(finite=finite)
        return truth.t_us, truth, self._read()

    def prepare(self) -> None:
        """Compute the inputs of the next step that do not depend on its controls; a change of the
        wind then takes effect one step later."""
        if self._flight["used_up"]:
            self._flight["used_up"] = 0
            self.weather.refill()
            for fitted in self.compiled_sensors:
                fitted.refill()
        step_kernel.prepare(self.board.flight)

    def quiet_until_us(self) -> int:
        """The time before which a step consists of compiled code alone, if no block of random
        numbers is used up."""
        if self.packed is None or self.terrain is not None:
            return 0
        ends = [one.due_us for one in self.onboard_sensors]
        ends += [float(one.record["due_us"]) for one in self._late]
        ends += [self._delayed[0][0]] if self._delayed else []
        return math.ceil(min(ends, default=NEVER_US))

    def _checked(self, controls: Controls) -> Array:
        values = controls.values
        count = self.vehicle.controls_count
        if len(values) != count or not math.isfinite(sum(values.tolist())):
            raise ConfigError(
                f"controls: {values.tolist()} at {self.truth.t_us * 1e-6:.3f} s cannot be used; "
                f"{count} finite numbers are needed"
            )
        return values if controls.armed else np.zeros(count)

    def plant(self, name: str, value: float | None) -> None:
        """Set a plant fault, or remove it with None.

        Names: the vehicle's `plant_names`, those of wind and sensors (`plant_names`), and those of
        the GNSS sensor.

        Raises
        ------
        ConfigError
            If the name is unknown or the value is impossible.
        """
        if name not in self._plant_names:
            fitted, state = self._with_satellite_plant(name, value)
            fitted.state = state
        elif name in SENSORS:
            self._flight["disturbance"][SENSORS.index(name)] = value or 0.0
        elif name in WIND:
            axis = WIND.index(name)
            healthy = self.scenario.environment.wind_ned_mps[axis]
            self.weather.steady_mps[axis] = healthy if value is None else value
        else:
            # Rebuilt from all active faults, so that their order has no effect.
            changed = {k: v for k, v in self._plant.items() if k != name}
            if value is not None:
                changed[name] = value
            try:
                self.vehicle = self.vehicle.with_plant(changed)
            except ValueError as error:
                raise ConfigError(f"plant: {name} = {value} is impossible; {error}") from None
            self._plant = changed

    def check_plant(self, name: str) -> None:
        """Refuse a plant fault that this simulation does not support; changes nothing.

        Raises
        ------
        ConfigError
            Lists the supported names.
        """
        if name not in self._plant_names:
            self._with_satellite_plant(name, None)

    @property
    def _plant_names(self) -> tuple[str, ...]:
        """The supported plant faults but those of the GNSS sensor."""
        sensors = [name for name in SENSORS if self.scenario.sensors.mag or name not in COMPASS]
        return (*self.vehicle.plant_names, *WIND, *sensors)

    def pitot_offset_pa(self) -> float | None:
        """The pitot tube's offset in still air [Pa], as a preflight calibration measures it; None
        without a pitot tube."""
        for fitted in self.compiled_sensors:
            if fitted.sensor.kind == PITOT:
                noise = fitted.state.noises[0]
                return float(noise.bias[0] + noise.drift[0])
        return None

    def _with_satellite_plant(self, name: str, value: float | None) -> tuple[OnboardSensor, Any]:
        """The GNSS sensor, and its state with one plant fault set."""
        of_signals = name in RECEIVER or name.partition("[")[0] in SIGNALS
        for fitted in self.onboard_sensors if of_signals else ():
            sensor: Any = fitted.sensor
            if hasattr(sensor, "with_plant"):
                return fitted, sensor.with_plant(fitted.state, name, value)
        kind, known = self.scenario.vehicle.kind, ", ".join(self._plant_names)
        raise ConfigError(f"plant: {name} is unknown to this {kind}; known: {known}")

    def _initial_state(self) -> Array:
        """The vehicle's initial state: trimmed flight in the air, or standing on the ground."""
        start, scenario = self.scenario.start, self.scenario
        heading = math.radians(start.heading_deg)
        vehicle = self.vehicle
        zero = np.zeros(3)
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
                motors = slice(RIGID_SIZE, RIGID_SIZE + vehicle.controls_count)
                x[motors] = vehicle.hover_rps(*self._air_and_gravity(x))
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
        locate_state(x, np.zeros(3), self.home.packed, location)
        return float(location[AIR + 2]), math.hypot(*location[LOCAL_GRAVITY:])

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

    def observe(self, *, finite: bool = True) -> Truth:
        """Update `truth` to the state of the board.

        Raises
        ------
        ConfigError
            If the state is not finite.
        """
        flight = self._flight
        if not finite:
            raise ConfigError(
                f"the simulation diverged at {flight['t_us'] * 1e-6:.3f} s; check the vehicle's "
                "parameters, controls and plant faults"
            )
        here = self._here.copy()
        lat, lon, height, pressure, temperature, density = here[:VELOCITY].tolist()
        alt = height - self.home.geoid_m
        terrain = self.terrain
        agl = alt - (terrain.ground(lat, lon) if terrain else float(flight["ground_m"]))
        flight["agl_m"] = agl
        x, load = self._x.copy(), self._load.copy()
        volts, amperes, charge = load[VOLTS:].tolist()
        self.truth = Truth(
            int(flight["t_us"]),
            lat,
            lon,
            height,
            alt,
            agl,
            x[:U],
            here[VELOCITY:ATTITUDE],
            here[ATTITUDE:AIR_VELOCITY],
            x[P:RIGID_SIZE],
            load[:VOLTS],
            here[AIR_VELOCITY:LOCAL_GRAVITY],
            flight["wind"].copy(),
            pressure,
            temperature,
            density,
            volts,
            amperes,
            charge,
            agl < self.vehicle.standing_height_m + 0.02,
        )
        return self.truth

    def _read(self) -> list[Reading]:
        """The readings delivered at this step, including delayed ones."""
        truth, t_us = self.truth, self.truth.t_us
        out: list[Reading] = []
        for fitted in self.onboard_sensors:
            if t_us < fitted.due_us:
                continue
            if fitted.latency_us == 0:
                out += fitted.sample(truth)
                continue
            for reading in fitted.sample(truth):
                self._delay(fitted, reading)
        for late in self._late:
            if late.record["fresh"]:
                self._delay(late, (late.record, late.record["values"].copy()))
                late.record["fresh"] = 0
        while self._delayed and self._delayed[0][0] <= t_us:
            item = heapq.heappop(self._delayed)[2]
            if isinstance(item, tuple):
                record, record_values = item
                record["values"], record["fresh"] = record_values, 1
            else:
                # Stamped at delivery: the link does not reveal the age of a measurement.
                out.append(msgspec.structs.replace(item, t_us=t_us))
        return out

    def _delay(self, sensor: OnboardSensor, item: Any) -> None:
        """Keep a reading, or a record with its values, until it is delivered."""
        # The counter orders items of the same time, as they cannot be compared.
        due_us = self.truth.t_us + sensor.latency_us
        heapq.heappush(self._delayed, (due_us, next(self._order), item))


def _with_home_on_terrain(scenario: Scenario, terrain: TerrainGrid) -> Scenario:
    """The scenario with home at the height of the terrain."""
    start = scenario.start
    alt = terrain.ground(math.radians(start.lat_deg), math.radians(start.lon_deg))
    return msgspec.structs.replace(scenario, start=msgspec.structs.replace(start, alt_m=alt))

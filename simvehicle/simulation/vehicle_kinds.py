"""The kinds of vehicle, with everything kind-specific that the simulator needs.

To add a kind, write a module with a `KindDefinition` and add a line to `VEHICLE_KINDS`; in another
package, register it as an entry point of the group `simvehicle.kinds`.
"""

from collections.abc import Callable, Mapping
from importlib.metadata import entry_points
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from mavproxy_fault.documents.errors import ConfigError
from simvehicle.autopilot.enums import MavType
from simvehicle.guidance.fixedwing_controller import FixedWingController
from simvehicle.guidance.multirotor_controller import MultirotorController
from simvehicle.guidance.route import GuidanceTrack
from simvehicle.guidance.rudderless_controller import RudderlessController, has_rudder
from simvehicle.vehicles.actuators import Mix, motor_mix, plane_mix
from simvehicle.vehicles.body import Controls, Truth
from simvehicle.vehicles.fixedwing.fixedwing import FixedWing
from simvehicle.vehicles.fixedwing.fixedwing_flight import THROTTLE
from simvehicle.vehicles.multirotor.multirotor import Multirotor
from simvehicle.vehicles.vehicle import Vehicle

KIND_ENTRY_POINTS = "simvehicle.kinds"


class Controller(Protocol):
    """The built-in controller of a kind; `track` and `landing` may be changed at any time."""

    track: GuidanceTrack | None
    landing: bool
    rate_hz: float
    drifts: bool  # wind displaces its turns
    lateral_mps2: float  # lateral acceleration of planned turns

    def update(self, truth: Truth) -> Controls:
        """Controls for the next control period."""

    def circle(
        self, north_m: float, east_m: float, height_m: float, speed_mps: float
    ) -> GuidanceTrack:
        """A track that waits at a point, circling or hovering."""


class KindDefinition(NamedTuple):
    """One kind of vehicle; functions of a vehicle take one that `read` returned.

    Parameters
    ----------
    read : function of a parameter set's name or path
    controller : function of vehicle, air density [kg/m^3] and home's height above sea level [m]
    mav_type, mix : functions of a vehicle
        Its MAV_TYPE, and the mapping from an autopilot's channels to its actuators.
    actuators : function of a vehicle
        Names of its controls.
    motors : function of a vehicle
        Number of motors that can fail.
    throttle : function of the controls
        The throttle command of the motors, 0 to 1.
    parameters : mapping
        Parameters for a ground station in addition to the common ones; SYS_AUTOSTART is the
        equivalent PX4 airframe.
    """

    read: Callable[[str], Vehicle]
    controller: Callable[[Any, float, float], Controller]
    mav_type: Callable[[Any], MavType]
    mix: Callable[[Any], Mix]
    actuators: Callable[[Any], list[str]]
    motors: Callable[[Any], int]
    throttle: Callable[[NDArray[np.float64]], float]
    parameters: Mapping[str, int | float]


def _wing_controller(vehicle: FixedWing, density: float, home_alt_m: float) -> FixedWingController:
    # Without a rudder, tight bank control by ailerons alone diverges in yaw.
    kind = FixedWingController if has_rudder(vehicle) else RudderlessController
    return kind(vehicle, density, home_alt_m)


VEHICLE_KINDS = {
    "fixedwing": KindDefinition(
        read=FixedWing.read,
        controller=_wing_controller,
        mav_type=lambda _: MavType.FIXED_WING,
        mix=lambda _: plane_mix,
        actuators=lambda _: ["elevator", "aileron", "rudder", "throttle"],
        motors=lambda _: 1,
        throttle=lambda controls: float(controls[THROTTLE]),
        parameters={"SYS_AUTOSTART": 1030, "MIS_TAKEOFF_ALT": 50.0, "RTL_RETURN_ALT": 100.0},
    ),
    "multirotor": KindDefinition(
        read=Multirotor.read,
        controller=lambda vehicle, _, home_alt_m: MultirotorController(vehicle, home_alt_m),
        mav_type=lambda vehicle: (
            MavType.HEXAROTOR if vehicle.controls_count == 6 else MavType.QUADROTOR
        ),
        mix=lambda vehicle: motor_mix(vehicle.controls_count),
        actuators=lambda vehicle: [f"motor {i + 1}" for i in range(vehicle.controls_count)],
        motors=lambda vehicle: int(vehicle.controls_count),
        throttle=lambda controls: float(controls.mean()),
        parameters={"SYS_AUTOSTART": 10016},
    ),
}


def find_vehicle_kind(name: str) -> KindDefinition:
    """Find a kind by its name.

    Raises
    ------
    ConfigError
        If there is no such kind.
    """
    # The shipped kinds come first, so that an installed package cannot replace them.
    if name in VEHICLE_KINDS:
        return VEHICLE_KINDS[name]
    others = {point.name: point for point in entry_points(group=KIND_ENTRY_POINTS)}
    if name not in others:
        known = ", ".join([*VEHICLE_KINDS, *others])
        raise ConfigError(f"vehicle.kind = {name} is unknown; known: {known}")
    kind: KindDefinition = others[name].load()
    return kind

"""A ground station on an `AutopilotLink`, without sockets: pymavlink packs and reads."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import all as dialect

from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame
from simvehicle.autopilot.autopilot_link import AutopilotLink
from simvehicle.autopilot.flight_goals import CommandedFlight
from simvehicle.autopilot.mission_service import Missions
from simvehicle.autopilot.parameter_service import Parameters
from simvehicle.autopilot.telemetry import HomePosition
from simvehicle.vehicles.body import Truth

HOME = HomePosition(47.397742, 8.545594, 488.0)
M_PER_DEG = 111_320.0


def locate(lat_deg: float, lon_deg: float, alt_m: float) -> np.ndarray:
    """Flat Earth around home: accurate enough to locate a goal."""
    east = (lon_deg - HOME.lon_deg) * M_PER_DEG * math.cos(math.radians(HOME.lat_deg))
    return np.array([(lat_deg - HOME.lat_deg) * M_PER_DEG, east, HOME.alt_m - alt_m])


class Station:
    """One vehicle, its link, and a ground station that uses pymavlink."""

    def __init__(self) -> None:
        self.parameters = Parameters()
        self.missions = Missions()
        self.flight = CommandedFlight(self.parameters, self.missions, HOME, locate)
        self.failed: list[tuple[int, bool]] = []
        self.link = AutopilotLink(self.flight, self.parameters, self.missions, self.fail_motor)
        self.mav = dialect.MAVLink(None, srcSystem=255, srcComponent=190)
        self.t_us = 0
        self.at(np.zeros(3))

    def fail_motor(self, number: int, off: bool) -> bool:
        self.failed.append((number, off))
        return number <= 4

    def at(self, r_ned_m: Any, seconds: float = 0.0, **changes: Any) -> list[Any]:
        """Let time pass with the vehicle at a position; returns its messages."""
        place = np.array(r_ned_m, dtype=float)
        self.t_us += round(seconds * 1e6)
        truth = self.truth(place, **changes)
        return self.read(self.link.tick(self.t_us, truth, [], 0.5))

    def truth(self, place: np.ndarray, **changes: Any) -> Truth:
        values: dict[str, Any] = {
            "t_us": self.t_us,
            "lat_rad": math.radians(HOME.lat_deg + place[0] / M_PER_DEG),
            "lon_rad": math.radians(HOME.lon_deg),
            "height_m": 535.0 - place[2],
            "alt_msl_m": HOME.alt_m - place[2],
            "height_agl_m": -place[2],
            "r_ned_m": place,
            "v_ned_mps": np.zeros(3),
            "q_nb": np.array([1.0, 0, 0, 0]),
            "omega_b_rps": np.zeros(3),
            "specific_force_b_mps2": np.array([0.0, 0.0, -9.80665]),
            "v_air_b_mps": np.zeros(3),
            "wind_ned_mps": np.zeros(3),
            "pressure_pa": 95600.0,
            "temperature_k": 285.0,
            "density_kgpm3": 1.16,
            "battery_v": 16.0,
            "battery_a": 1.0,
            "battery_remaining": 0.75,
            "on_ground": place[2] >= 0,
        }
        return Truth(**(values | changes))

    def send(self, name: str, *values: Any) -> list[Any]:
        """Send one message by its pymavlink encoder; returns the vehicle's answers."""
        message = getattr(self.mav, name + "_encode")(*values)
        frame = Frame(message.pack(self.mav), message_layout(message.get_type()))
        return self.read(self.link.received(frame, self.t_us))

    def command(self, number: int, *params: float) -> list[Any]:
        """Send a COMMAND_LONG; returns the acknowledgement and the other messages."""
        filled = [*params, *([math.nan] * (7 - len(params)))]
        return self.send("command_long", 1, 1, number, 0, *filled)

    def read(self, frames: list[bytes]) -> list[Any]:
        """The messages in a list of frames."""
        return dialect.MAVLink(None).parse_buffer(b"".join(frames)) or []


@pytest.fixture
def station() -> Station:
    """A vehicle at home, disarmed."""
    return Station()


@pytest.fixture
def upload(station: Station) -> Callable[[list[tuple[int, float, float, float]]], int]:
    """Upload a mission of (command, north m, east m, height m); the result of the upload."""

    def run(items: list[tuple[int, float, float, float]]) -> int:
        answers = station.send("mission_count", 1, 1, len(items), 0)
        for seq, (command, north, east, up) in enumerate(items):
            assert answers[0].get_type() == "MISSION_REQUEST_INT"
            assert answers[0].seq == seq
            lat = HOME.lat_deg + north / M_PER_DEG
            lon = HOME.lon_deg + east / M_PER_DEG / math.cos(math.radians(HOME.lat_deg))
            answers = station.send(
                "mission_item_int", 1, 1, seq, 6, command, 0, 1, 0, 0, 0, math.nan,
                round(lat * 1e7), round(lon * 1e7), up, 0,
            )  # fmt: skip
        assert answers[0].get_type() == "MISSION_ACK"
        return int(answers[0].type)

    return run

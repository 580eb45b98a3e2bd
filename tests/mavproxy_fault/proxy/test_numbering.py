"""Sequence numbers of the proxy's own frames, checked by pymavlink's loss counter."""

from collections.abc import Iterable

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega

from mavproxy_fault.live.control import LiveControl
from mavproxy_fault.proxy.core import Core, LinkRole, Send
from mavproxy_fault.proxy.engine import Engine
from mavproxy_fault.schedule.entries import Schedule, parse_schedule
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import build_frame

SIM, GCS = 0, 1
WALL_US = 1_700_000_000_000_000
PLANT = """
seed: 1
faults:
  - {id: heavy, fault: plant, target: PLANT.mass_kg_add, value: 0.5, at_s: 0.5, for_s: 2}
  - {id: weak, fault: plant, target: 'PLANT.motor_efficiency[0]', value: 0.5, at_s: 1, for_s: 2}
"""


class Station:
    """A ground station between a vehicle, whose frames count from 250 on, and a proxy."""

    def __init__(self, schedule: Schedule, roles: tuple[str, str], component: int = 1) -> None:
        engine = Engine(schedule)
        links = LinkRole("sim", roles[0]), LinkRole("gcs", roles[1])  # type: ignore[arg-type]
        self.core = Core(links, engine, control=LiveControl(engine))
        self.component = component
        self.frames = 0
        self.counter = mavutil.mavfile(None, "station")
        self.names: list[str] = []

    def hears(self, sends: Iterable[Send]) -> None:
        parser = ardupilotmega.MAVLink(None)
        for send in sends:
            for message in parser.parse_buffer(send.data) or [] if send.link == GCS else []:
                message._timestamp = 0.0
                self.counter.post_message(message)
                self.names.append(message.get_type())

    def vehicle_speaks(self, frames: int) -> None:
        for _ in range(frames):
            values = {"time_usec": 1_000_000 + 100_000 * self.frames, "fields_updated": 63}
            layout, seq = message_layout("HIL_SENSOR"), (250 + self.frames) & 0xFF
            raw = build_frame(layout, values, seq=seq, component=self.component)
            self.hears(self.core.received(SIM, raw, WALL_US + 100_000 * self.frames))
            self.frames += 1

    def commands(self, times: int) -> None:
        for seq in range(times):
            values = {"command": 420, "param1": 0, "param2": 4, "target_system": 1}
            raw = build_frame(
                message_layout("COMMAND_LONG"), values, seq=seq, system=255, component=190
            )
            self.hears(self.core.received(GCS, raw, WALL_US + 100_000 * self.frames))


def test_announcements_and_plant_frames_share_sequence_numbers() -> None:
    station = Station(parse_schedule(PLANT), ("to-vehicle", "to-vehicle"), component=51)
    station.vehicle_speaks(40)
    assert station.names.count("TUNNEL") > 10
    assert station.names.count("STATUSTEXT") == 4
    assert station.counter.mav_loss == 0


@pytest.mark.parametrize("times", [1, 2, 20])
def test_answers_in_the_vehicles_name_cost_at_most_256_lost_frames(times: int) -> None:
    station = Station(Schedule(1), ("from-vehicle", "to-vehicle"))
    station.vehicle_speaks(4)
    station.commands(times)
    assert station.counter.mav_loss == 0
    station.vehicle_speaks(20)
    assert station.names.count("COMMAND_ACK") == times
    assert station.counter.mav_loss == 256 - times


def test_answers_for_a_silent_vehicle_are_numbered_consecutively() -> None:
    station = Station(Schedule(1), ("from-vehicle", "to-vehicle"))
    station.vehicle_speaks(1)
    station.commands(3)
    assert station.names.count("COMMAND_ACK") == 3
    assert station.counter.mav_loss == 0

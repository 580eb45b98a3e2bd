"""The built-in controller's commands over the wire and back."""

import numpy as np
import pytest

from mavproxy_fault.wire.frame import Frame, build_frame
from mavproxy_fault.wire.parser import Parser
from simvehicle.hil.actuator_commands import ActuatorCommands
from simvehicle.simulation.vehicle_kinds import VEHICLE_KINDS

VALUES = {
    ("fixedwing", "aerosonde-2025"): [0.25, -0.5, 0.125, 0.75],
    ("multirotor", "iris"): [0.5, 0.625, 0.75, 0.0],
    ("multirotor", "hexa"): [0.5, 0.625, 0.75, 0.25, 1.0, 0.0],
}


@pytest.mark.parametrize("vehicle", VALUES)
def test_commands_return_unchanged(vehicle: tuple[str, str]) -> None:
    kind = VEHICLE_KINDS[vehicle[0]]
    read = kind.read(vehicle[1])
    commands = ActuatorCommands(kind.actuators(read), kind.mix(read))
    assert commands.last_received is None
    raw = build_frame(*commands.message(1_000_000, np.array(VALUES[vehicle])))
    (frame,) = Parser().push(raw, datagram=True)
    assert isinstance(frame, Frame)
    commands.receive(frame)
    assert commands.last_received is not None
    assert commands.last_received.armed
    assert commands.last_received.values.tolist() == VALUES[vehicle]

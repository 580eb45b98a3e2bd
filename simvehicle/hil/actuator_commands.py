"""The built-in controller's commands as HIL_ACTUATOR_CONTROLS, as an autopilot would send them.

This lets a proxy change them on the way: they go out as frames in PX4's channels (see
`simvehicle.vehicles.actuators`) and come back as controls.
"""

from collections.abc import Sequence

from mavproxy_fault.numerics.arrays import Array
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame
from simvehicle.hil.hil_messages import Message
from simvehicle.vehicles.actuators import (
    ARMED_FLAG,
    CHANNEL_COUNT,
    ELEVATOR,
    LEFT_AILERON,
    RIGHT_AILERON,
    RUDDER,
    THROTTLE,
    Mix,
    read_controls,
)
from simvehicle.vehicles.body import Controls

HIL_ACTUATOR_CONTROLS = message_layout("HIL_ACTUATOR_CONTROLS")
# Surface or throttle -> its channels and their signs; a motor's channel is its number
ACTUATOR_CHANNELS: dict[str, tuple[tuple[int, float], ...]] = {
    "elevator": ((ELEVATOR, -1.0),),
    "aileron": ((RIGHT_AILERON, 1.0), (LEFT_AILERON, -1.0)),
    "rudder": ((RUDDER, -1.0),),
    "throttle": ((THROTTLE, 1.0),),
}


def actuator_channels(actuators: Sequence[str]) -> list[tuple[tuple[int, float], ...]]:
    """The channels of each actuator of a vehicle, and their signs."""
    return [ACTUATOR_CHANNELS.get(name, ((at, 1.0),)) for at, name in enumerate(actuators)]


class ActuatorCommands:
    """The commands of one vehicle; `last_received` is the last command that came back."""

    def __init__(self, actuators: Sequence[str], mix: Mix) -> None:
        self.last_received: Controls | None = None
        self._mix = mix
        self._channels = actuator_channels(actuators)

    def message(self, t_us: int, values: Array) -> Message:
        """The message that commands the actuators to `values` (n,) at `t_us`."""
        channels = [0.0] * CHANNEL_COUNT
        for value, outputs in zip(values.tolist(), self._channels, strict=True):
            for channel, sign in outputs:
                channels[channel] = sign * value
        fields = {"time_usec": t_us, "controls": channels, "mode": ARMED_FLAG}
        return HIL_ACTUATOR_CONTROLS, fields

    def receive(self, frame: Frame) -> None:
        """Take a message at the actuators, including any changes made on the way."""
        if frame.layout.name == HIL_ACTUATOR_CONTROLS.name:
            self.last_received = read_controls(frame, self._mix)[1]

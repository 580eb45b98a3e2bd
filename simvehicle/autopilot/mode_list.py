"""The flight modes as a ground station lists them, by AVAILABLE_MODES [1]_.

References
----------
.. [1] MAVLink developer guide, "Standard Modes Protocol".
"""

from simvehicle.autopilot.enums import Mode, StandardMode
from simvehicle.hil.outgoing_message import Message, message

# Name and standard mode of each, in the order in which they are listed
LISTED = {
    Mode.TAKEOFF: (b"Takeoff", StandardMode.TAKEOFF),
    Mode.HOLD: (b"Hold", StandardMode.NON_STANDARD),
    Mode.MISSION: (b"Mission", StandardMode.MISSION),
    Mode.RETURN: (b"Return", StandardMode.SAFE_RECOVERY),
    Mode.LAND: (b"Land", StandardMode.LAND),
}


def available_modes(index: int) -> list[Message]:
    """The mode with this index, from 1, or all of them for 0; none beyond the last."""
    every = [
        message(
            "AVAILABLE_MODES",
            number_modes=len(LISTED),
            mode_index=number,
            standard_mode=standard,
            custom_mode=mode,
            mode_name=name,
        )
        for number, (mode, (name, standard)) in enumerate(LISTED.items(), 1)
    ]
    # Counted from 1.
    return every if index == 0 else every[index - 1 : index]

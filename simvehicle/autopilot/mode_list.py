"""The flight modes in the list that AVAILABLE_MODES reports to a ground station [1]_.

References
----------
.. [1] MAVLink developer guide, "Standard Modes Protocol".
"""

from simvehicle.autopilot.enums import FlightMode, StandardMode
from simvehicle.hil.outgoing_message import Message, make_message

# Name and standard mode of each, in the order of the list
LISTED_MODES = {
    FlightMode.TAKEOFF: (b"Takeoff", StandardMode.TAKEOFF),
    FlightMode.HOLD: (b"Hold", StandardMode.NON_STANDARD),
    FlightMode.MISSION: (b"Mission", StandardMode.MISSION),
    FlightMode.RETURN: (b"Return", StandardMode.SAFE_RECOVERY),
    FlightMode.LAND: (b"Land", StandardMode.LAND),
}


def available_modes(index: int) -> list[Message]:
    """The AVAILABLE_MODES message of an index from 1, or of all for 0; none beyond the last."""
    messages = [
        make_message(
            "AVAILABLE_MODES",
            number_modes=len(LISTED_MODES),
            mode_index=number,
            standard_mode=standard,
            custom_mode=mode,
            mode_name=name,
        )
        for number, (mode, (name, standard)) in enumerate(LISTED_MODES.items(), 1)
    ]
    return messages if index == 0 else messages[index - 1 : index]

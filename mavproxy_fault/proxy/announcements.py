"""Labels as STATUSTEXT of the proxy's component, so that every log viewer shows them."""

from typing import TYPE_CHECKING

from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame

if TYPE_CHECKING:
    from mavproxy_fault.wire.label import Label

COMPONENT = 191  # MAV_COMP_ID_ONBOARD_COMPUTER
NOTICE = 5  # MAV_SEVERITY_NOTICE
TEXT_LENGTH = 50


def label_text(label: "Label") -> str:
    """Describe a label in one line, such as `FAULT gyro-step on: bias HIL_SENSOR.xgyro`."""
    if label.by:
        phase = "on" if label.end_us is None else "off"
        return f"FAULT {label.id} {phase}: {label.fault} by the {label.by}"
    if label.end_us is not None:
        return f"FAULT {label.id} off: {label.frames} frames"
    if label.changed_us is not None:
        return f"FAULT {label.id} value: {label.value:g}"
    return f"FAULT {label.id} on: {label.preset or label.fault} {' '.join(label.targets)}".rstrip()


def label_announcement(label: "Label", system: int) -> Frame:
    """Create the STATUSTEXT of a label, truncated to the message's 50 characters."""
    layout = message_layout("STATUSTEXT")
    # Old receivers of STATUSTEXT support only ASCII.
    values = {
        "severity": NOTICE,
        "text": label_text(label).encode("ascii", "replace")[:TEXT_LENGTH],
    }
    return Frame(build_frame(layout, values, system=system, component=COMPONENT), layout)

"""Outgoing messages: a layout and the values of its fields."""

from collections.abc import Mapping

from mavproxy_fault.wire.dialect import Layout, message_layout

Message = tuple[Layout, Mapping[str, object]]


def make_message(name: str, **values: object) -> Message:
    """Make the message `name`; omitted fields are zero."""
    return message_layout(name), values


def statustext(text: str, severity: int = 6) -> Message:
    """STATUSTEXT; severity 6 is MAV_SEVERITY_INFO."""
    # 50 bytes is the field's size.
    return make_message("STATUSTEXT", severity=severity, text=text.encode()[:50])

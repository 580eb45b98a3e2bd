"""A message to send: its layout and the values of its fields."""

from collections.abc import Mapping

from mavproxy_fault.wire.dialect import Layout, known

Message = tuple[Layout, Mapping[str, object]]


def message(name: str, **values: object) -> Message:
    """The message `name`; fields not given are zero."""
    return known(name), values


def statustext(text: str, severity: int = 6) -> Message:
    """STATUSTEXT; severity 6 is MAV_SEVERITY_INFO."""
    return message("STATUSTEXT", severity=severity, text=text.encode()[:50])

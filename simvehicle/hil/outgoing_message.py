"""Outgoing messages: a layout and the values of its fields."""

from collections.abc import Mapping

from mavproxy_fault.wire.dialect import Field, Layout, message_layout

Message = tuple[Layout, Mapping[str, object]]

# Not in pymavlink; from MAVLink's standard.xml, CRC extra 217
PROTOCOL_VERSION = Layout(
    name="PROTOCOL_VERSION",
    id=300,
    crc_extra=217,
    instance="",
    fields={
        name: Field(name, kind, count, "", False, offset)
        for name, kind, count, offset in (
            ("version", "uint16_t", 0, 0),
            ("min_version", "uint16_t", 0, 2),
            ("max_version", "uint16_t", 0, 4),
            ("spec_version_hash", "uint8_t", 8, 6),
            ("library_version_hash", "uint8_t", 8, 14),
        )
    },
    length=22,
    base_length=22,
)


def make_message(name: str, **values: object) -> Message:
    """Make the message `name`; omitted fields are zero."""
    return message_layout(name), values


def statustext(text: str, severity: int = 6) -> Message:
    """STATUSTEXT; severity 6 is MAV_SEVERITY_INFO."""
    # 50 bytes is the field's size.
    return make_message("STATUSTEXT", severity=severity, text=text.encode()[:50])

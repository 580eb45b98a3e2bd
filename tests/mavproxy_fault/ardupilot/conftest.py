"""Output of a real ArduCopter to the bridge in one flight; see the data's README."""

from pathlib import Path

import pytest

RECORDED = Path(__file__).resolve().parents[2] / "data" / "arducopter"
SERVO_BYTES = 40


@pytest.fixture(scope="session", params=["handshake.txt", "handshake_4.5.txt"])
def handshake_lines(request: pytest.FixtureRequest) -> list[bytes]:
    """The lines of its VectorNav driver, in order; of 4.7 and of 4.5."""
    return (RECORDED / request.param).read_bytes().splitlines(keepends=True)


@pytest.fixture(scope="session")
def servo_packets() -> list[bytes]:
    """Its servo packets at the start, about arming and about lift-off."""
    data = (RECORDED / "servos.bin").read_bytes()
    return [data[at : at + SERVO_BYTES] for at in range(0, len(data), SERVO_BYTES)]


@pytest.fixture(scope="session")
def mavlink_bytes() -> bytes:
    """Its heartbeats, replies and texts."""
    return (RECORDED / "mavlink.bin").read_bytes()

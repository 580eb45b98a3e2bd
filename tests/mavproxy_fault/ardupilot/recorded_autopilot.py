"""A substitute for ArduPilot's SITL program that replays the output of a recorded flight.

It takes the options that the bridge gives, and before them `--ends-after N` servo packets.
"""

import argparse
import socket
import sys
from pathlib import Path

RECORDED = Path(__file__).resolve().parents[2] / "data" / "arducopter"
PACKET = 40  # bytes
TIMEOUT_S = 20.0


def main() -> int:
    """Configure the sensor, request physics, reply with servo packets."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--ends-after", type=int)
    parser.add_argument("--sim-port-out", type=int)
    parser.add_argument("--serial0")
    parser.add_argument("--serial6")
    options, _ = parser.parse_known_args()
    mavlink = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    mavlink.connect(("127.0.0.1", int(options.serial0.rsplit(":", 1)[1])))
    sensor = socket.create_connection(("127.0.0.1", int(options.serial6.rsplit(":", 1)[1])))
    sensor.settimeout(TIMEOUT_S)
    for line in (RECORDED / "handshake.txt").read_bytes().splitlines(keepends=True):
        sensor.sendall(line)
        assert b"\r\n" in sensor.recv(256)  # after the last line outputs may follow at once
    mavlink.send((RECORDED / "mavlink.bin").read_bytes()[:1000])
    physics = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    physics.settimeout(TIMEOUT_S)
    servos = (RECORDED / "servos.bin").read_bytes()
    packets = [servos[at : at + PACKET] for at in range(0, len(servos), PACKET)]
    for packet in packets[: options.ends_after]:
        physics.sendto(packet, ("127.0.0.1", options.sim_port_out))
        assert b'"timestamp":' in physics.recv(4096)
    heard = sensor.recv(65536)
    assert heard[:4] == b"\xfa\x01\x21\x07"
    return 3


if __name__ == "__main__":
    sys.exit(main())

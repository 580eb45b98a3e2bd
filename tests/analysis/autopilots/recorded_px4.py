"""A stand-in for PX4 that sends what a real one sent in a recorded flight.

It is started as PX4 is, answers each HIL_SENSOR of id 0 by the answer to its stamp, and ends with
exit code 3 when there are no more, or with `--stays` says nothing from then on.
"""

import re
import socket
import sys
from pathlib import Path

from mavproxy_fault.wire.frame import Frame
from mavproxy_fault.wire.parser import Parser

RECORDED = Path(__file__).resolve().parents[2] / "data" / "px4"
TIMEOUT_S = 60.0


def main() -> int:
    """Send a first frame on both links, then answer."""
    instance = int(sys.argv[sys.argv.index("-i") + 1])
    place = Path(sys.argv[sys.argv.index("-w") + 1])
    remote = re.search(r"-o (\d+)", (place / "px4-rc.mavlink").read_text())
    assert remote is not None
    hello, *answers = Parser().push((RECORDED / "hil.bin").read_bytes())
    by_stamp = {answer.number("time_usec"): answer.raw for answer in answers}
    telemetry = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    for frame in Parser().push((RECORDED / "telemetry.bin").read_bytes()):
        telemetry.sendto(frame.raw, ("127.0.0.1", int(remote[1])))
    hil = socket.create_connection(("127.0.0.1", 4560 + instance), timeout=TIMEOUT_S)
    hil.sendall(hello.raw)
    print("INFO  [px4] Startup script returned successfully", flush=True)
    parser, last_us = Parser(), max(by_stamp)
    while data := hil.recv(65536):
        for frame in parser.push(data):
            if not isinstance(frame, Frame) or frame.layout.name != "HIL_SENSOR":
                continue
            stamp_us = frame.number("time_usec")
            if stamp_us in by_stamp:
                hil.sendall(by_stamp[stamp_us])
            if stamp_us >= last_us and "--stays" not in sys.argv:
                print("there is no more", flush=True)
                return 3
    return 4


if __name__ == "__main__":
    sys.exit(main())

"""An autopilot as a process: reads HIL_SENSOR, answers it, and says the attitude the gyro gives.

`python stand_in.py PORT`. Its estimate starts from the first HIL_STATE_QUATERNION.
"""

import contextlib
import socket
import sys

import numpy as np
from pymavlink.dialects.v20 import all as dialect


def turned(q, rate, dt_s):
    w, x, y, z = q
    p, r, s = rate
    slope = [-p * x - r * y - s * z, p * w + s * y - r * z, r * w - s * x + p * z,
             s * w + r * x - p * y]  # fmt: skip
    q = q + 0.5 * dt_s * np.array(slope)
    return q / np.linalg.norm(q)


def main(port):
    sock = socket.create_connection(("127.0.0.1", port), timeout=20)
    mav = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    reader = dialect.MAVLink(None)
    sock.sendall(mav.heartbeat_encode(1, 12, 0, 0, 4).pack(mav))
    q, last_us = None, None
    while data := sock.recv(65536):
        for message in reader.parse_buffer(data) or []:
            if message.get_type() == "HIL_STATE_QUATERNION" and q is None:
                q = np.array(message.attitude_quaternion)
            if message.get_type() != "HIL_SENSOR":
                continue
            t_us = message.time_usec
            if q is not None and last_us is not None:
                rate = (message.xgyro, message.ygyro, message.zgyro)
                q = turned(q, rate, (t_us - last_us) * 1e-6)
            last_us = t_us
            out = b""
            if q is not None and t_us // 1000 % 20 == 0:
                says = mav.attitude_quaternion_encode(t_us // 1000, *q.tolist(), 0.0, 0.0, 0.0)
                out = says.pack(mav)
            answer = mav.hil_actuator_controls_encode(t_us, [0.0] * 16, 1, 1)
            sock.sendall(out + answer.pack(mav))


if __name__ == "__main__":
    with contextlib.suppress(ConnectionError):  # the flight is over
        main(int(sys.argv[1]))

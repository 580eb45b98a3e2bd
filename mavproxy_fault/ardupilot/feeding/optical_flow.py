"""Conversion of HIL_OPTICAL_FLOW to the OPTICAL_FLOW of ArduPilot's MAVLink driver; no I/O.

The driver (FLOW_TYPE 5) multiplies the integers `flow_x` and `flow_y` by its scale factors and by
the time since the previous frame, which it measures itself, and uses the product as a rate in rad/s
[1]_. So the value sent is the rate divided by that time; a small scale factor gives a resolution of
0.0005 rad/s at 20 Hz. ArduPilot compensates rotation with its own gyro.

References
----------
.. [1] ArduPilot, `libraries/AP_OpticalFlow/AP_OpticalFlow_MAV.cpp`.
"""

from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame

OPTICAL_FLOW = message_layout("OPTICAL_FLOW")
SCALER = -990  # FLOW_FXSCALER and FLOW_FYSCALER: thousandths added to a factor of 1
SCALE = 1.0 + SCALER * 1e-3
INT16_MAX = 0x7FFF
DRIVER_TIMEOUT_US = 500_000  # after this gap the driver treats a frame as the first


class FlowInput:
    """Converts the optical flow of one flight."""

    def __init__(self) -> None:
        self._last_us: int | None = None

    def step(self, frame: Frame, t_us: int) -> bytes | None:
        """Convert a HIL_OPTICAL_FLOW received at `t_us`; None if one had the same time."""
        since_us = DRIVER_TIMEOUT_US if self._last_us is None else t_us - self._last_us
        if since_us <= 0:
            return None  # the driver would divide by zero time
        self._last_us = t_us
        read = frame.number
        integration_us = read("integration_time_us")
        # From an angle over the integration time to a rate, in the driver's counts.
        per_rad = 1e12 / (integration_us * since_us * SCALE) if integration_us > 0 else 0.0
        values = {
            "time_usec": read("time_usec"),
            "sensor_id": read("sensor_id"),
            "flow_x": flow_counts(read("integrated_x") * per_rad),
            "flow_y": flow_counts(read("integrated_y") * per_rad),
            "quality": read("quality"),
            "ground_distance": read("distance"),
        }
        return build_frame(
            OPTICAL_FLOW, values, seq=frame.seq, system=frame.system, component=frame.component
        )


def flow_counts(value: float) -> int:
    """Round and clamp to an int16; NaN becomes 0."""
    return round(min(max(value, -INT16_MAX), INT16_MAX)) if value == value else 0

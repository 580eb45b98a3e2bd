"""HIL_OPTICAL_FLOW as the OPTICAL_FLOW that ArduPilot's MAVLink driver reads; no I/O.

The driver (FLOW_TYPE 5) multiplies the whole numbers of `flow_x` and `flow_y` by its scale factors
and by the time since the frame before, as it measures that itself, and calls the product a rate in
rad/s [1]_. So what is sent is the rate over that time, in steps that a small scale factor makes
fine: 0.0005 rad/s at 20 Hz. The gyro's share is ArduPilot's own.

References
----------
.. [1] ArduPilot, `libraries/AP_OpticalFlow/AP_OpticalFlow_MAV.cpp`.
"""

from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame

OPTICAL_FLOW = message_layout("OPTICAL_FLOW")
SCALER = -990  # FLOW_FXSCALER and FLOW_FYSCALER: thousandths that are added to a factor of 1
SCALE = 1.0 + SCALER * 1e-3
INT16_MAX = 0x7FFF  # of an int16
DRIVER_TIMEOUT_US = (
    500_000  # after so long the driver takes a frame for the first and reads no flow
)


class FlowInput:
    """The flow sensor of one flight."""

    def __init__(self) -> None:
        self._last_us: int | None = None

    def step(self, frame: Frame, t_us: int) -> bytes | None:
        """OPTICAL_FLOW for a HIL_OPTICAL_FLOW that came at `t_us`; None for a second at once."""
        since_us = DRIVER_TIMEOUT_US if self._last_us is None else t_us - self._last_us
        if since_us <= 0:
            return None  # the driver would divide the flow of two frames by no time
        self._last_us = t_us
        read = frame.number
        integration_us = read("integration_time_us")
        # From an angle over the sensor's own time to a rate, and to the driver's counts of it.
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
    """The nearest whole number that the field holds; 0 for what is no number."""
    return round(min(max(value, -INT16_MAX), INT16_MAX)) if value == value else 0

"""A coherent GNSS spoof: moves every message with position or velocity by the same offset.

The offset is in the local level frame (north, east, down). While it changes, the velocity changes
accordingly, so that each message is consistent in itself and with the others. Metres are converted
to degrees with the radii of curvature of the WGS 84 ellipsoid [1]_. Values that a message marks as
unknown stay unknown.

References
----------
.. [1] NIMA TR8350.2, "World Geodetic System 1984", third edition; the radii are in its chapter 4.
"""

import math
from typing import Any, ClassVar

import msgspec

from mavproxy_fault.fault_parts.elements import locate_element, write_elements
from mavproxy_fault.fault_parts.fault import ActsOn, Generator, Outgoing
from mavproxy_fault.fault_parts.profile import Seconds
from mavproxy_fault.fault_parts.spoofed_messages import MOVERS, Move, Three
from mavproxy_fault.wire.frame import Frame


class GpsSpoof(msgspec.Struct, frozen=True, kw_only=True):
    """Move all positions by `offset_m` within `ramp_s`, then further at `velocity_mps`.

    Both are [north, east, down]. Without `ramp_s` the offset is a jump. `value` is short for an
    offset to the north. `velocity_error_mps` is added to the velocity only. Acts on HIL_GPS,
    GPS_RAW_INT, GPS2_RAW, GPS_INPUT, GLOBAL_POSITION_INT, LOCAL_POSITION_NED and ODOMETRY (but not
    from vision, motion capture or lidar), or on those of these messages given as target.
    """

    name: ClassVar[str] = "gps-spoof"
    example: ClassVar[dict[str, Any]] = {"offset_m": [100, 0, 0]}
    acts_on: ClassVar[ActsOn] = "frames"
    messages: ClassVar[tuple[str, ...]] = tuple(MOVERS)

    value: float | None = None
    offset_m: Three = (0.0, 0.0, 0.0)
    velocity_mps: Three = (0.0, 0.0, 0.0)
    velocity_error_mps: Three = (0.0, 0.0, 0.0)
    ramp_s: Seconds = 0.0

    def __post_init__(self) -> None:
        moves = (*self.offset_m, *self.velocity_mps, *self.velocity_error_mps)
        if self.value is None and not any(moves):
            raise ValueError(
                "has no effect; give value, offset_m, velocity_mps or velocity_error_mps"
            )

    def shift(self, t_s: float) -> Move:
        """Return the offset and its rate, `t_s` after the start of the spoof."""
        offset = self.offset_m if self.value is None else (self.value, 0.0, 0.0)
        t_s = max(t_s, 0.0)  # the sender's clock may be behind the one that started the fault
        if t_s < self.ramp_s:
            # Consistent with the moving position, or innovation tests would detect the spoof.
            share, rate = t_s / self.ramp_s, 1.0 / self.ramp_s
            return Move(_scaled(offset, share), _scaled(offset, rate))
        extra = _scaled(self.velocity_mps, t_s - self.ramp_s)
        moved = (offset[0] + extra[0], offset[1] + extra[1], offset[2] + extra[2])
        return Move(moved, self.velocity_mps)

    def new_state(self, start_us: int) -> int:
        """Return the start time."""
        return start_us

    def apply(
        self, frame: Frame, t_us: int, state: int, rng: Generator
    ) -> tuple[list[Outgoing], int]:
        """Move one frame; forward messages without a position."""
        mover = MOVERS.get(frame.layout.name)
        if mover is None:
            return [Outgoing(t_us, frame)], state
        moved = self.shift((t_us - state) / 1e6)
        pairs = zip(moved.velocity_mps, self.velocity_error_mps, strict=True)
        north, east, down = (velocity + error for velocity, error in pairs)
        shift = Move(moved.offset_m, (north, east, down))
        values = mover(frame, shift)
        elements = [locate_element(frame.layout, name) for name in values]
        out = write_elements(frame, t_us, elements, list(values.values()))
        # Position and velocity are unknown in this frame.
        if out.frame is frame:
            return [out], state
        # The magnitude is the norm of the offset, not the change of a single field.
        size = math.hypot(*shift.offset_m) or math.hypot(*self.velocity_error_mps)  # m, or m/s
        return [Outgoing(t_us, out.frame, size, out.saturated)], state


def _scaled(vector: Three, factor: float) -> Three:
    return vector[0] * factor, vector[1] * factor, vector[2] * factor

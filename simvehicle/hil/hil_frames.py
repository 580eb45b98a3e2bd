"""The frames of a HIL simulator, as PX4 1.18 expects them; no I/O.

Per step: HIL_SENSOR of id 0 (which sets PX4's clock), those of further ids, then the readings of
other sensors (raw GNSS observations as RTCM in TUNNEL), HEARTBEAT once a second, and the truth as
HIL_STATE_QUATERNION. `frame_kernel` packs the first and the last, which are nearly all of the
traffic.
"""

from collections.abc import Iterable, Mapping

import numpy as np

from mavproxy_fault.numerics.crc import slicing_tables
from mavproxy_fault.rtcm.msm7 import encode_epoch
from mavproxy_fault.rtcm.transport import tunnel_frames
from mavproxy_fault.wire.dialect import Layout
from mavproxy_fault.wire.frame import build_frame
from mavproxy_fault.wire.parser import walk_frames
from simvehicle.hil import hil_messages
from simvehicle.hil.frame_kernel import IDS, PACKER, pack_sensors, pack_truth
from simvehicle.hil.hil_messages import Message
from simvehicle.sensors.flight_record import Board
from simvehicle.sensors.readings import (
    BatteryReading,
    EphemerisReading,
    PseudorangeReading,
    Reading,
)

IMU_IDS, MAG_IDS, BARO_IDS = IDS, 2, 2  # PX4 ignores higher ids

START_US = 1_000_000  # timestamp of t_us = 0, as PX4 refuses 0
HEARTBEAT_US = 1_000_000
AUTOPILOT_INVALID = 8  # MAV_AUTOPILOT_INVALID: the simulator is no autopilot
TYPE_QUADROTOR = 2  # MAV_TYPE_QUADROTOR


class HilPacker:
    """Packs the frames of the simulator's end of a HIL link.

    Parameters
    ----------
    board : Board
        The flight, at whose state the frames of a step are packed.
    system, component : int
        Source of the frames.
    start_us : int
        Timestamp on the wire at the simulation's t_us = 0.
    mav_type : int
        MAV_TYPE of the heartbeat.

    Attributes
    ----------
    step_us : int or None
        Timestamp of the last step on the wire, which an autopilot answers.
    heartbeat_us : int
        The due time of the next heartbeat.
    records : array of PACKER, shape (1,)
    """

    def __init__(
        self,
        board: Board,
        system: int = 1,
        component: int = 51,
        start_us: int = START_US,
        mav_type: int = TYPE_QUADROTOR,
    ) -> None:
        assert (board.sensors["id"] < IDS).all(), "the kernel's arrays end there"
        self.start_us = start_us
        self.step_us: int | None = None
        self.records = np.zeros(1, dtype=PACKER)
        self._board, self._packer = board, self.records[0]
        for name, value in (("system", system), ("component", component), ("start_us", start_us)):
            self._packer[name] = value
        self._packer["crc"] = np.reshape(slicing_tables(), (-1, 256))
        self._source = {"system": system, "component": component}
        self._out = self._packer["out"]
        self._mav_type = mav_type
        self._rtcm = 0  # RTCM messages sent
        self.heartbeat_us = 0
        self._consumed_mah = 0.0
        self._battery: BatteryReading | None = None

    def frames(self, readings: Iterable[Reading]) -> list[bytes]:
        """Pack the frames of one step with the readings delivered at it.

        The readings' own timestamps may be earlier than the step's.
        """
        flight, sensors = self._board
        t_us = int(flight["t_us"][0])
        self.step_us = t_us + self.start_us
        pack_sensors(flight, sensors, self.records)
        packed = self.packed_bytes()
        out = [packed[start:end] for start, end, _ in walk_frames(packed)]
        for reading in readings:
            if isinstance(reading, (PseudorangeReading, EphemerisReading)):
                for message in rtcm_messages(reading):
                    out += self._tunnel(message)
            else:
                out.append(self._build(*self._message(reading)))
        if t_us >= self.heartbeat_us:
            # The next full second, so that a late heartbeat does not shift the later ones.
            self.heartbeat_us = t_us - t_us % HEARTBEAT_US + HEARTBEAT_US
            out.append(self._build(*self._heartbeat()))
        begin = int(self._packer["length"])
        pack_truth(flight, self.records)
        return [*out, self.packed_bytes()[begin:]]

    def packed_bytes(self) -> bytes:
        """The frames of the last step that compiled code has packed."""
        data: bytes = self._out[: self._packer["length"]].tobytes()
        return data

    def _message(self, reading: Reading) -> Message:
        """The message of a reading that is not part of HIL_SENSOR."""
        stamp = reading.t_us + self.start_us
        if isinstance(reading, BatteryReading):
            self._consumed_mah += hil_messages.drawn_mah(self._battery, reading)
            self._battery = reading
            return hil_messages.battery_status(reading, self._consumed_mah)
        return hil_messages.READING_MESSAGES[type(reading)](reading, stamp)

    def _tunnel(self, message: bytes) -> list[bytes]:
        """TUNNEL frames with one RTCM message."""
        seq = int(self._packer["seq"])
        frames = tunnel_frames(message, self._rtcm, seq=seq, **self._source)
        self._rtcm += 1
        self._packer["seq"] = (seq + len(frames)) & 0xFF
        return frames

    def _heartbeat(self) -> Message:
        return hil_messages.make_message(
            "HEARTBEAT", type=self._mav_type, autopilot=AUTOPILOT_INVALID, mavlink_version=3
        )

    def _build(self, layout: Layout, values: Mapping[str, object]) -> bytes:
        seq = int(self._packer["seq"])
        self._packer["seq"] = (seq + 1) & 0xFF
        return build_frame(layout, values, seq=seq, **self._source)


def rtcm_messages(reading: PseudorangeReading | EphemerisReading) -> list[bytes]:
    """The RTCM messages of a reading: MSM7 of one epoch, or one ephemeris."""
    if isinstance(reading, EphemerisReading):
        return [reading.rtcm]
    return encode_epoch(
        reading.tow_s,
        reading.satellites,
        reading.pseudorange_m.tolist(),
        reading.doppler_mps.tolist(),
        reading.cn0_dbhz.tolist(),
    )

"""Readings and truth -> the frames of a HIL simulator, as PX4 1.18 expects them; no I/O.

Per step: HIL_SENSOR of id 0 (which sets PX4's clock), those of further ids, then the other readings
(raw GNSS observations as RTCM in TUNNEL), HEARTBEAT once a second, and the truth as
HIL_STATE_QUATERNION. HIL_SENSOR has the last value of every field; `fields_updated` marks the new
ones. PX4 uses a group of fields only if all its bits are set; pressure has three.

HIL_SENSOR and HIL_STATE_QUATERNION are packed here instead of by `wire.frame.build`, as they are
nearly all of the traffic.
"""

import struct
from collections.abc import Iterable, Mapping

from mavproxy_fault.rtcm.msm7 import encode_epoch
from mavproxy_fault.rtcm.transport import tunnel_frames
from mavproxy_fault.wire.dialect import Layout, message_layout
from mavproxy_fault.wire.frame import build_frame, frame_payload
from simvehicle.hil import hil_messages
from simvehicle.hil.outgoing_message import Message
from simvehicle.hil.state_kernel import TruthPayload, fill_truth_payload
from simvehicle.sensors.readings import (
    AirspeedReading,
    BatteryReading,
    EphemerisReading,
    ImuReading,
    MagReading,
    PressureReading,
    PseudorangeReading,
    Reading,
)
from simvehicle.vehicles.body import Truth

HIL_SENSOR = message_layout("HIL_SENSOR")
HIL_STATE_QUATERNION = message_layout("HIL_STATE_QUATERNION")
HEARTBEAT = message_layout("HEARTBEAT")

# HIL_SENSOR_UPDATED_*, by group
ACCEL, GYRO, MAG, BARO, DIFF_PRESSURE = 0x7, 0x38, 0x1C0, 0x1A00, 0x400
IMU_IDS, MAG_IDS, BARO_IDS = 3, 2, 2  # PX4 ignores higher ids

START_US = 1_000_000  # timestamp of t_us = 0, as PX4 refuses 0
HEARTBEAT_US = 1_000_000
AUTOPILOT_INVALID = 8  # MAV_AUTOPILOT_INVALID: the simulator is no autopilot
TYPE_QUADROTOR = 2  # MAV_TYPE_QUADROTOR

PA_PER_HPA = 100.0

_SENSOR = struct.Struct("<Q13fIB")
# Indices of HIL_SENSOR's floats.
_ACC, _GYRO, _MAG = slice(0, 3), slice(3, 6), slice(6, 9)
_PRESSURE, _DIFF_PRESSURE, _PRESSURE_ALT, _TEMPERATURE, _FLOATS = range(9, 14)


class HilPacker:
    """Packs the frames of the simulator's end of a HIL link.

    Parameters
    ----------
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
    seq, heartbeat_us, sensor_fields
        The next sequence number, the due time of the next heartbeat, and the fields of HIL_SENSOR
        by id; steps that are computed elsewhere update them.
    """

    def __init__(
        self,
        system: int = 1,
        component: int = 51,
        start_us: int = START_US,
        mav_type: int = TYPE_QUADROTOR,
    ) -> None:
        self.start_us = start_us
        self.step_us: int | None = None
        self.system = system
        self.component = component
        self._mav_type = mav_type
        self.seq = 0
        self._rtcm = 0  # RTCM messages sent
        self.heartbeat_us = 0
        self.sensor_fields = [[0.0] * _FLOATS for _ in range(IMU_IDS)]
        self._truth = TruthPayload()
        self._consumed_mah = 0.0
        self._battery_us: int | None = None

    def frames(self, t_us: int, truth: Truth, readings: Iterable[Reading]) -> list[bytes]:
        """Pack the frames of one step.

        Parameters
        ----------
        t_us : int
            Time of the step on the simulation's clock, and timestamp of HIL_SENSOR.
        truth : Truth
            Sent as HIL_STATE_QUATERNION.
        readings : iterable of Reading
            The readings delivered at this step; their own timestamps may be earlier.
        """
        stamp = self.step_us = t_us + self.start_us
        updated = [0] * IMU_IDS
        others = []
        for reading in readings:
            if isinstance(reading, (ImuReading, MagReading, PressureReading, AirspeedReading)):
                self._store(reading, updated)
            else:
                others.append(reading)
        out = [self._sensor(stamp, bits, number) for number, bits in enumerate(updated) if bits]
        for reading in others:
            if isinstance(reading, (PseudorangeReading, EphemerisReading)):
                for message in rtcm_messages(reading):
                    out += self._tunnel(message)
            else:
                out.append(self._build(*self._message(reading)))
        if t_us >= self.heartbeat_us:
            # The next full second, so that a late heartbeat does not shift the later ones.
            self.heartbeat_us = t_us - t_us % HEARTBEAT_US + HEARTBEAT_US
            out.append(self._build(*self._heartbeat()))
        out.append(self.truth(stamp, truth))
        return out

    def truth(self, stamp_us: int, truth: Truth) -> bytes:
        """HIL_STATE_QUATERNION: the true attitude, position and velocity."""
        payload = self._truth
        payload.stamp[0] = stamp_us
        fill_truth_payload(
            truth.q_nb,
            truth.omega_b_rps,
            truth.v_ned_mps,
            truth.specific_force_b_mps2,
            truth.v_air_b_mps,
            (truth.lat_rad, truth.lon_rad, truth.alt_msl_m, truth.density_kgpm3),
            payload.bytes,
        )
        return self._frame(HIL_STATE_QUATERNION, payload.bytes.tobytes())

    def _store(
        self,
        reading: ImuReading | MagReading | PressureReading | AirspeedReading,
        updated: list[int],
    ) -> None:
        """Store a reading in the fields of its HIL_SENSOR and mark them as updated."""
        if isinstance(reading, ImuReading):
            fields = self.sensor_fields[reading.id]
            fields[_ACC] = reading.accel_b_mps2
            fields[_GYRO] = reading.gyro_b_rps
            updated[reading.id] |= ACCEL | GYRO
        elif isinstance(reading, MagReading):
            self.sensor_fields[reading.id][_MAG] = reading.field_b_gauss
            updated[reading.id] |= MAG
        elif isinstance(reading, PressureReading):
            fields = self.sensor_fields[reading.id]
            fields[_PRESSURE] = reading.pressure_pa / PA_PER_HPA
            fields[_PRESSURE_ALT] = reading.pressure_alt_m
            fields[_TEMPERATURE] = reading.temperature_c
            updated[reading.id] |= BARO
        else:
            self.sensor_fields[0][_DIFF_PRESSURE] = reading.diff_pressure_pa / PA_PER_HPA
            updated[0] |= DIFF_PRESSURE

    def _message(self, reading: Reading) -> Message:
        """The message of a reading that is not part of HIL_SENSOR."""
        stamp = reading.t_us + self.start_us
        if isinstance(reading, BatteryReading):
            return hil_messages.battery_status(reading, self._consume(reading))
        return hil_messages.READING_MESSAGES[type(reading)](reading, stamp)

    def _tunnel(self, message: bytes) -> list[bytes]:
        """TUNNEL frames with one RTCM message."""
        frames = tunnel_frames(
            message, self._rtcm, seq=self.seq, system=self.system, component=self.component
        )
        self._rtcm += 1
        self.seq = (self.seq + len(frames)) & 0xFF
        return frames

    def _consume(self, reading: BatteryReading) -> float:
        """Charge drawn until this reading [mAh]."""
        if self._battery_us is not None:
            hours = (reading.t_us - self._battery_us) / 3.6e9
            self._consumed_mah += reading.current_a * 1e3 * hours
        self._battery_us = reading.t_us
        return self._consumed_mah

    def _heartbeat(self) -> Message:
        return HEARTBEAT, {
            "type": self._mav_type,
            "autopilot": AUTOPILOT_INVALID,
            "mavlink_version": 3,
        }

    def _sensor(self, stamp_us: int, updated: int, number: int) -> bytes:
        return self._frame(
            HIL_SENSOR, _SENSOR.pack(stamp_us, *self.sensor_fields[number], updated, number)
        )

    def _frame(self, layout: Layout, payload: bytes) -> bytes:
        return frame_payload(
            layout, payload, seq=self._next(), system=self.system, component=self.component
        )

    def _build(self, layout: Layout, values: Mapping[str, object]) -> bytes:
        return build_frame(
            layout, values, seq=self._next(), system=self.system, component=self.component
        )

    def _next(self) -> int:
        seq = self.seq
        self.seq = (seq + 1) & 0xFF
        return seq


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

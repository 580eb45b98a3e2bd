"""What the HIL link shows before the autopilot starts: its sensors, its rate, where it stands.

The simulator goes on without an answer until the autopilot is there.
"""

from dataclasses import dataclass

from mavproxy_fault.ardupilot.hil_readings import BARO, MAG, Readings, TrueState
from mavproxy_fault.ardupilot.parameters import AvailableSensors
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.wire.frame import Frame

DISCOVERY_US = 1_000_000
SLOWEST_HZ, FASTEST_HZ = 50.0, 1000.0
VISION = "ODOMETRY", "VISION_POSITION_ESTIMATE"


@dataclass(frozen=True, slots=True)
class DiscoveredVehicle:
    """What was observed; `readings` goes on being updated."""

    readings: Readings
    home: TrueState
    sensors: AvailableSensors


class SensorDiscovery:
    """A second of the vehicle's time on the HIL link, in which every sensor shows itself.

    Parameters
    ----------
    where : str
        The HIL link's name, for messages.
    """

    def __init__(self, where: str) -> None:
        self._where = where
        self._readings = Readings()
        self._stamps: list[int] = []
        self._sensors: set[tuple[str, int]] = set()
        self._first: TrueState | None = None

    def update(self, frame: Frame) -> DiscoveredVehicle | None:
        """Read a frame; what was seen, once it is enough.

        Raises
        ------
        ConfigError
            If ArduPilot cannot fly on what comes.
        """
        # Ids tell whether there is a second IMU or receiver.
        number = int(frame.number("id")) if "id" in frame.layout.fields else 0
        self._sensors.add((frame.layout.name, number))
        truth = self._readings.truth if self._readings.update(frame) else None
        if truth is None:
            return None
        self._first = self._first or truth
        self._stamps.append(truth.t_us)
        # In the vehicle's time: of a slow simulator as many steps are wanted.
        if self._stamps[-1] - self._stamps[0] < DISCOVERY_US:
            return None
        check_sensors(self._readings, self._where)
        return DiscoveredVehicle(self._readings, self._first, self._fitted())

    def _fitted(self) -> AvailableSensors:
        rate_hz = 1e6 * (len(self._stamps) - 1) / (self._stamps[-1] - self._stamps[0])
        if not SLOWEST_HZ <= rate_hz <= FASTEST_HZ:
            raise ConfigError(
                f"{self._where}: {rate_hz:g} steps a second are not for ArduPilot; "
                f"{SLOWEST_HZ:g} to {FASTEST_HZ:g} are, 400 for a copter"
            )
        return AvailableSensors(
            rate_hz,
            second_imu=("HIL_SENSOR", 1) in self._sensors,
            second_gps=("HIL_GPS", 1) in self._sensors,
            rangefinder=("DISTANCE_SENSOR", 0) in self._sensors,
            flow=("HIL_OPTICAL_FLOW", 0) in self._sensors,
            vision=any((name, 0) in self._sensors for name in VISION),
        )


def check_sensors(readings: Readings, where: str) -> None:
    """Refuse a vehicle without what EKF3 needs.

    Raises
    ------
    ConfigError
        With the sensor that is missing.
    """
    for name, bits in (("compass", MAG), ("barometer", BARO)):
        if readings.updated & bits != bits:
            raise ConfigError(
                f"{where}: HIL_SENSOR comes without a {name}; ArduPilot needs IMU, compass, "
                "barometer and GPS"
            )
    if not readings.fixes:
        raise ConfigError(f"{where}: no HIL_GPS comes; ArduPilot needs a GPS of id 0")

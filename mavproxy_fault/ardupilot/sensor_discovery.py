"""Sensor discovery on the HIL link before the autopilot starts: sensors, step rate, position.

The simulator runs without answers until then.
"""

from dataclasses import dataclass

from mavproxy_fault.ardupilot.hil_readings import BARO, MAG, Readings, TrueState
from mavproxy_fault.ardupilot.parameters import SensorName
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.wire.frame import Frame

DISCOVERY_US = 1_000_000  # chosen: every sensor of a HIL simulator reports within a second
SLOWEST_HZ, FASTEST_HZ = 50.0, 1000.0  # step rates accepted by the bridge


@dataclass(frozen=True, slots=True)
class DiscoveredVehicle:
    """Result of the discovery; `readings` is updated further."""

    readings: Readings
    home: TrueState
    rate_hz: float  # of the steps
    sensors: frozenset[SensorName]


class SensorDiscovery:
    """Discovers the sensors in one second of vehicle time, in which every sensor reports.

    Parameters
    ----------
    where : str
        The HIL link's name, for messages.
    """

    def __init__(self, where: str) -> None:
        self._where = where
        self._readings = Readings()
        self._stamps: list[int] = []
        self._sensors: set[SensorName] = set()
        self._first: TrueState | None = None

    def update(self, frame: Frame) -> DiscoveredVehicle | None:
        """Read a frame; return the result once a second is complete, else None.

        Raises
        ------
        ConfigError
            If ArduPilot cannot fly on the available sensors.
        """
        # The id distinguishes a second IMU or receiver.
        number = int(frame.number("id")) if "id" in frame.layout.fields else 0
        self._sensors.add((frame.layout.name, number))
        truth = self._readings.truth if self._readings.update(frame) else None
        if truth is None:
            return None
        self._first = self._first or truth
        self._stamps.append(truth.t_us)
        # Vehicle time, so that a slow simulator delivers as many steps.
        if self._stamps[-1] - self._stamps[0] < DISCOVERY_US:
            return None
        check_sensors(self._readings, self._where)
        sensors = frozenset(self._sensors)
        return DiscoveredVehicle(self._readings, self._first, self._rate_hz(), sensors)

    def _rate_hz(self) -> float:
        rate_hz = 1e6 * (len(self._stamps) - 1) / (self._stamps[-1] - self._stamps[0])
        if not SLOWEST_HZ <= rate_hz <= FASTEST_HZ:
            raise ConfigError(
                f"{self._where}: runs at {rate_hz:g} steps/s; ArduPilot needs "
                f"{SLOWEST_HZ:g} to {FASTEST_HZ:g}, best 400 for a copter"
            )
        return rate_hz


def check_sensors(readings: Readings, where: str) -> None:
    """Refuse a vehicle without the sensors that EKF3 needs.

    Raises
    ------
    ConfigError
        With the missing sensor.
    """
    for name, bits in (("compass", MAG), ("barometer", BARO)):
        if readings.updated & bits != bits:
            raise ConfigError(
                f"{where}: HIL_SENSOR has no {name}; ArduPilot needs IMU, compass, "
                "barometer and GPS"
            )
    if not readings.fixes:
        raise ConfigError(f"{where}: no HIL_GPS was received; ArduPilot needs a GPS of id 0")

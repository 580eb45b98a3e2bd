"""A short flight as a tlog, nominal unless a test adds a problem."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from mavproxy_fault.wire import tlog
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import build_frame

NOON_US = 1_700_000_000_000_000
ARDUPILOT, COPTER = 3, 2

Flight = Callable[..., Path]


def frames(
    seconds: int,
    *,
    vibration: float = 10.0,
    jump_at_s: float | None = None,
    variance: float = 0.1,
    texts: tuple[tuple[int, int, bytes], ...] = (),
    lost: int = 0,
    system: int = 1,
) -> list[tuple[int, bytes]]:
    """Stamps and frames of an ArduPilot copter that drifts north at 1 m/s, 5 Hz, armed from 2 s."""
    records: list[tuple[int, bytes]] = []
    seq = 0

    def send(t_s: float, name: str, **values: object) -> None:
        nonlocal seq
        raw = build_frame(message_layout(name), values, seq=seq % 256, system=system)
        records.append((NOON_US + round(t_s * 1e6), raw))
        seq += 1

    for tick in range(seconds * 5):
        t_s = tick / 5
        ms = 1000 + tick * 200
        if tick % 5 == 0:
            armed = 0x80 if t_s >= 2 else 0
            send(
                t_s, "HEARTBEAT", type=COPTER, autopilot=ARDUPILOT, base_mode=armed,
                custom_mode=5 if t_s < 5 else 3, system_status=4,
            )  # fmt: skip
            send(t_s, "PARAM_VALUE", param_id=b"WPNAV_SPEED", param_value=500.0 if t_s < 6 else 300)
        lat = 470_000_000 + round(t_s * 89.9)
        if jump_at_s is not None and t_s >= jump_at_s:
            lat += 17_980  # 200 m
        place = {"lat": lat, "lon": 80_000_000, "alt": 500_000}
        send(
            t_s, "GPS_RAW_INT", **place, fix_type=3, eph=90, epv=120, vel=100,
            satellites_visible=12,
        )  # fmt: skip
        send(t_s, "GLOBAL_POSITION_INT", **place, time_boot_ms=ms, relative_alt=10_000, vx=100)
        send(t_s, "ATTITUDE", time_boot_ms=ms, roll=0.1, pitch=-0.05, yaw=3.0)
        send(t_s, "VFR_HUD", groundspeed=1.0, throttle=40)
        send(t_s, "VIBRATION", vibration_x=5.0, vibration_y=5.0, vibration_z=vibration)
        send(t_s, "EKF_STATUS_REPORT", flags=0x1FF, compass_variance=variance)
        send(t_s, "SYS_STATUS", voltage_battery=12_000, current_battery=500, battery_remaining=80)
        for at_s, severity, words in texts:
            if tick == at_s * 5:
                send(t_s, "STATUSTEXT", severity=severity, text=words)
        seq += lost
    return records


def write_flight(folder: Path, name: str = "flight", seconds: int = 20, **trouble: object) -> Path:
    """Write a flight's tlog to a folder."""
    path = folder / f"{name}.tlog"
    records = frames(seconds, **trouble)  # type: ignore[arg-type]
    path.write_bytes(b"".join(tlog.log_record(*record) for record in records))
    return path


@pytest.fixture(scope="session")
def flight_in() -> Flight:
    """`write_flight`, for flights that several tests share."""
    return write_flight


@pytest.fixture
def flight(tmp_path: Path) -> Flight:
    """Write a flight's tlog: `flight(name, seconds, **trouble)`."""
    return partial(write_flight, tmp_path)

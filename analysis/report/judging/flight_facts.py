"""Key figures of a flight: duration, distance, height, speed and tilt while armed."""

import numpy as np

from analysis.report.curves.derived_curves import OWN_ATTITUDE
from analysis.report.curves.recording import FlightData, Signal, inside_windows
from analysis.report.curves.vehicle_phase import armed_windows

AXES = ("roll", "pitch", "yaw")


def flight_facts(recording: FlightData) -> list[tuple[str, str]]:
    """Name and value of each key figure, from the autopilot's own estimate while armed."""
    armed = armed_windows(recording)
    if not armed:
        return []
    found = [("armed", f"{sum(end - start for start, end in armed):.0f} s")]
    speed = _inside(recording, "speed", ("ground", "GPS"), armed)
    if speed is not None:
        # While disarmed the speed is NaN and adds no distance.
        steps = np.diff(speed.t_s) * (speed.value[1:] + speed.value[:-1]) / 2.0
        found.append(("distance over ground", _metres(float(np.nansum(steps)))))
        means = np.nanmean(speed.value), np.nanmax(speed.value)
        found.append(("ground speed, mean and largest", "{:.1f} and {:.1f} m/s".format(*means)))
    height = _inside(recording, "height", ("estimate", "controller"), armed)
    if height is not None:
        span_m = float(np.nanmax(height.value) - np.nanmin(height.value))
        found.append(("height range", _metres(span_m)))
    climb = _inside(recording, "climb", ("estimate", "CTUN", "VFR_HUD"), armed)
    if climb is not None:
        fastest = np.nanmax(climb.value), -np.nanmin(climb.value)
        found.append(("fastest climb and sink", "{:.1f} and {:.1f} m/s".format(*fastest)))
    tilt = _inside(recording, "tilt", OWN_ATTITUDE, armed)
    if tilt is not None:
        found.append(("largest tilt", f"{np.nanmax(tilt.value):.0f}°"))
    rates = [_inside(recording, f"rate-{axis}", ("actual",), armed) for axis in AXES]
    turned = [np.nanmax(np.abs(rate.value)) for rate in rates if rate is not None]
    if turned:
        found.append(("fastest rotation", f"{max(turned):.0f}°/s"))
    current = _inside(recording, "battery-current", ("battery", "SYS_STATUS"), armed)
    if current is not None:
        drawn = np.nanmean(current.value), np.nanmax(current.value)
        found.append(("current, mean and largest", "{:.1f} and {:.1f} A".format(*drawn)))
    return found


def _inside(
    recording: FlightData, panel: str, names: tuple[str, ...], armed: list[tuple[float, float]]
) -> Signal | None:
    """The first curve with one of the names, NaN outside the windows; None without any value."""
    if (signal := recording.curve(panel, *names)) is None:
        return None
    value = np.where(inside_windows(signal.t_s, armed), signal.value, np.nan)
    return signal._replace(value=value) if np.isfinite(value).any() else None


def _metres(length_m: float) -> str:
    return f"{length_m:.1f} m" if length_m < 100.0 else f"{length_m:,.0f} m"

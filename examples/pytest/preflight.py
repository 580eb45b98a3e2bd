"""Example of user code: checks by MAVSDK whether the vehicle may take off."""

import threading

from mavsdk import ComponentType, Configuration, Mavsdk
from mavsdk.plugins.telemetry import FixType, GpsInfo, Telemetry

CONNECTS_S = 30.0
SETTLES_S = 1.0  # the first report may be bad and improve
LEAST_SATELLITES = 6


def objections(url: str, silence_s: float = 30.0) -> list[str]:
    """Return the reasons against a take-off; `silence_s` is the timeout for GPS data."""
    wrong = ["the vehicle sends no GPS data"]
    heard, ready = threading.Event(), threading.Event()

    def look(info: GpsInfo, _: object) -> None:
        wrong[:] = wrong_with(info)
        heard.set()
        if not wrong:
            ready.set()

    station = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
    with Mavsdk(station) as mavsdk:
        mavsdk.add_any_connection(url)
        vehicle = mavsdk.first_autopilot(CONNECTS_S)
        if vehicle is None:
            return ["there is no vehicle"]
        telemetry = Telemetry(vehicle)
        handle = telemetry.subscribe_gps_info(look)
        if heard.wait(silence_s):
            ready.wait(SETTLES_S)
        telemetry.unsubscribe_gps_info(handle)
    return wrong


def wrong_with(info: GpsInfo) -> list[str]:
    """Return the errors in one report of the receiver."""
    wrong = []
    if info.fix_type.value < FixType.FIX_3D.value:
        wrong.append("there is no 3D fix")
    if info.num_satellites < LEAST_SATELLITES:
        wrong.append(f"{info.num_satellites} satellites are too few")
    return wrong

"""Code of a user: may the vehicle take off? Asked by MAVSDK, answered with what is wrong."""

import threading

from mavsdk import ComponentType, Configuration, Mavsdk
from mavsdk.plugins.telemetry import FixType, GpsInfo, Telemetry

CONNECTS_S = 30.0
SETTLES_S = 1.0  # a first report that is bad may still get better
LEAST_SATELLITES = 6


def objections(url: str, silence_s: float = 30.0) -> list[str]:
    """What speaks against a take-off; `url` is MAVSDK's address, a GPS may be silent so long."""
    wrong = ["the vehicle says nothing of its GPS"]
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
    """What is wrong with one report of the receiver."""
    wrong = []
    if info.fix_type.value < FixType.FIX_3D.value:
        wrong.append("there is no 3D fix")
    if info.num_satellites < LEAST_SATELLITES:
        wrong.append(f"{info.num_satellites} satellites are too few")
    return wrong

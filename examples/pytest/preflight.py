"""Code of a user: may the vehicle take off? Asked by MAVSDK, answered with what is wrong."""

import threading

from mavsdk import ComponentType, Configuration, Mavsdk
from mavsdk.plugins.telemetry import FixType, GpsInfo, Telemetry

CONNECTS_S = 30.0
LEAST_SATELLITES = 6


def objections(url: str, patience_s: float = 3.0) -> list[str]:
    """What still speaks against a take-off after some seconds; `url` is MAVSDK's address."""
    wrong = ["the vehicle says nothing of its GPS"]
    ready = threading.Event()

    def look(info: GpsInfo, _: object) -> None:
        wrong[:] = wrong_with(info)
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
        ready.wait(patience_s)
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

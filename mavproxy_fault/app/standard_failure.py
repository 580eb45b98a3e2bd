"""`inject UNIT:TYPE --through mavsdk`: sends MAV_CMD_INJECT_FAILURE to a vehicle by MAVSDK.

The vehicle executes it, or a proxy on the link: PX4 if SYS_FAILURE_EN is 1; ArduPilot does not
support the command.
"""

import argparse
import contextlib
import sys
import time
from typing import Any

from mavproxy_fault.app.command_result import print_result
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.suggestion import suggest_known

CONNECT_TIMEOUT_S = 10.0
DEFAULT_ADDRESS = "udpin://127.0.0.1:14540"  # MAVSDK's default port at PX4
REASONS = {
    "UNSUPPORTED": "the vehicle does not support this failure",
    "DENIED": "the vehicle refuses it; on PX4, set SYS_FAILURE_EN to 1",
    "DISABLED": "failure injection is disabled; set SYS_FAILURE_EN to 1",
    "TIMEOUT": "the vehicle did not reply; check --link",
}


def main(args: argparse.Namespace) -> int:
    """Send the failure, and end it after `--for`; return 1 if the vehicle refuses."""
    unit, kind, instance = parse_failure(args.fault or "")
    with connect_vehicle(args.link or DEFAULT_ADDRESS) as failure:
        refusal = send_failure(failure, unit, kind, instance)
        if refusal:
            print(f"{args.fault}: {refusal}", file=sys.stderr)
            return 1
        accepted = {"fault": args.fault, "state": "accepted"}
        print_result(args, accepted, f"{args.fault}: accepted")
        if args.for_s is None:
            return 0
        try:
            time.sleep(args.for_s)
        except KeyboardInterrupt:
            print("ended early", file=sys.stderr)
        refusal = send_failure(failure, unit, mavsdk_failure_types()["ok"], instance)
        state = refusal or "ended"
        print_result(args, {"fault": args.fault, "state": state}, f"{args.fault}: {state}")
        return 1 if refusal else 0


def mavsdk_units() -> dict[str, Any]:
    """Return MAVSDK's failure units by short name, such as `gps` or `motor`."""
    from mavsdk.plugins.failure import FailureUnit

    return {
        unit.name.removeprefix("SENSOR_").removeprefix("SYSTEM_").lower().replace("_", "-"): unit
        for unit in FailureUnit
    }


def mavsdk_failure_types() -> dict[str, Any]:
    """Return MAVSDK's failure types by name."""
    from mavsdk.plugins.failure import FailureType

    return {kind.name.lower(): kind for kind in FailureType}


def parse_failure(text: str) -> tuple[Any, Any, int]:
    """Parse `UNIT:TYPE[:INSTANCE]` (instances count from 1, 0 is all) to unit, type and instance.

    Raises
    ------
    ConfigError
        If a part does not exist.
    """
    unit, _, rest = text.partition(":")
    kind, _, number = rest.partition(":")
    if unit not in mavsdk_units():
        raise ConfigError(
            f"inject: {unit!r} is not a failure unit; {suggest_known(unit, [*mavsdk_units()])}"
        )
    if kind not in mavsdk_failure_types():
        raise ConfigError(
            f"inject: {text} has no type; give UNIT:TYPE[:INSTANCE], such as gps:off, with "
            f"{', '.join(mavsdk_failure_types())}"
        )
    if not (number or "0").isdigit():
        raise ConfigError(f"inject: {text}: instance {number} is not a number; give 0 for all")
    return mavsdk_units()[unit], mavsdk_failure_types()[kind], int(number or 0)


def send_failure(failure: Any, unit: Any, kind: Any, instance: int) -> str:
    """Send a failure; return the reason of a refusal, or an empty string."""
    from mavsdk.plugins.failure import FailureError, FailureResult

    try:
        failure.inject(unit, kind, instance)
    except FailureError as error:
        result = next((one for one in error.args if isinstance(one, FailureResult)), None)
        name = "" if result is None else result.name
        return REASONS.get(name, f"MAVSDK reports {name or error}")
    return ""


@contextlib.contextmanager
def connect_vehicle(address: str) -> Any:
    """Connect MAVSDK to the vehicle at an address; yields its failure plugin.

    Raises
    ------
    ConfigError
        If the address is wrong or no vehicle is found.
    """
    from mavsdk import ComponentType, Configuration, Mavsdk, log_subscribe
    from mavsdk.plugins.failure import Failure

    log_subscribe(lambda *_: True)  # silences MAVSDK's log
    station = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
    with Mavsdk(station) as mavsdk:
        opened = mavsdk.add_any_connection(address)
        if opened.name != "SUCCESS":
            raise ConfigError(
                f"--link: {address} cannot be opened ({opened.name.lower()}); give a MAVSDK "
                f"address such as {DEFAULT_ADDRESS}, tcpout://HOST:PORT or serial:///dev/ttyACM0:57600"
            )
        system = mavsdk.first_autopilot(CONNECT_TIMEOUT_S)
        if system is None:
            raise ConfigError(
                f"--link: no vehicle at {address} within {CONNECT_TIMEOUT_S:g} s; check it"
            )
        yield Failure(system)

"""Write docs/zenoh.schema.json: the JSON Schema of every key on the bus, from the sources.

    python docs/write_schemas.py

`keys` names the type of each key below `mavfault/v1/{run}/`; the types stand in `$defs`.
"""

import inspect
import json
from pathlib import Path
from typing import Any

import msgspec

from analysis.results import AttitudeError, Decision, FusedState, Result, SensorDecision
from mavproxy_fault.live.bus_types import EndpointStatistics, Recording, ScheduleState
from mavproxy_fault.live.subscriptions import Watched
from mavproxy_fault.wire.label import Label

FILE = Path(__file__).with_name("zenoh.schema.json")
KEYS: dict[str, Any] = {
    "fdi/main/stat": Decision,
    "fdi/{sensor}/stat": SensorDecision,
    "fdi/events": Result,
    "fdi/isolation": Decision,
    "att/{estimator}/score": AttitudeError,
    "fusion/state": FusedState,
    "fusion/without-isolation": FusedState,
    "proxy/labels": Label,
    "proxy/stats": list[EndpointStatistics],
    "proxy/recording": Recording,
    "proxy/watched": list[Watched],
    "schedule/state": ScheduleState,
}


def anything(kind: type) -> dict[str, Any]:
    """The schema of a value that may be anything, as the parameters of a fault."""
    assert kind is object, kind
    return {"description": "a number, a text, or more of them"}


def or_null(found: Any) -> Any:
    """The same schema, with null wherever a number may not be finite: JSON has no word for it.

    Texts lose their indentation, as Python 3.13 and later take it from docstrings.
    """
    if isinstance(found, str):
        return inspect.cleandoc(found)
    if isinstance(found, list):
        return [or_null(one) for one in found]
    if not isinstance(found, dict):
        return found
    kinds = {"type": ["number", "null"]} if found.get("type") == "number" else {}
    return {key: or_null(one) for key, one in found.items()} | kinds


def schema() -> dict[str, Any]:
    """The whole document."""
    kinds = list(KEYS.values())
    found, components = msgspec.json.schema_components(
        kinds, schema_hook=anything, ref_template="#/$defs/{name}"
    )
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "What mavproxy-fault publishes on the bus, by key below mavfault/v1/{run}/",
        "keys": dict(zip(KEYS, or_null(list(found)), strict=True)),
        "$defs": or_null(components),
    }


def text() -> str:
    """The file's content."""
    return json.dumps(schema(), indent=1, sort_keys=True) + "\n"


if __name__ == "__main__":
    FILE.write_text(text(), encoding="utf-8")

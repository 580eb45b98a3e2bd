from pathlib import Path

import pytest

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.yaml_document import read_document
from mavproxy_fault.schedule.document_kind import kind_of
from mavproxy_fault.schedule.entries import parse_schedule, read_schedule

EXAMPLES = Path(__file__).parents[3] / "examples"


def test_every_example_is_known_for_what_it_is() -> None:
    for path in EXAMPLES.glob("*.yaml"):
        keys = read_document(path).data.keys()
        kind = (kind_of(keys) or "").split(",")[0]
        if keys <= {"seed", "faults"}:
            assert kind == ""
        elif "search" in path.name:
            assert kind == "a search", path
        else:
            assert kind == ("a campaign" if "campaign" in path.name else "a scenario"), path


def test_a_scenario_given_as_a_schedule_is_recognised() -> None:
    with pytest.raises(ConfigError, match=r"hover.yaml: is a scenario, which `mavproxy-fault run`"):
        read_schedule(EXAMPLES / "hover.yaml")


def test_a_misspelt_key_of_a_schedule_stays_its_own_error() -> None:
    with pytest.raises(ConfigError, match="did you mean faults"):
        parse_schedule({"seed": 1, "fault": []})

from collections.abc import Callable
from itertools import permutations
from pathlib import Path
from typing import Any

import pytest

from analysis.campaign.campaign_file import read_campaign
from analysis.search.space.test_file import read_test
from mavproxy_fault.documents.document_kind import check_kind
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.yaml_document import read_document
from mavproxy_fault.schedule.entries import parse_schedule, read_schedule
from simvehicle.scenario.scenario_file import open_scenario

EXAMPLES = Path(__file__).parents[3] / "examples"
READERS: dict[str, tuple[Callable[[Path], Any], str, str]] = {
    "a schedule": (read_schedule, "gyro_bias.yaml", "run --schedule"),
    "a scenario": (open_scenario, "hover.yaml", "run"),
    "a campaign": (read_campaign, "campaign_estimators.yaml", "campaign"),
    "a search": (read_test, "gyro_search.yaml", "search"),
}


def test_every_example_has_a_recognised_kind() -> None:
    for path in EXAMPLES.glob("*.yaml"):
        document = read_document(path)
        if document.data.keys() <= {"seed", "faults"}:
            kind = "a schedule"
        elif "search" in path.name:
            kind = "a search"
        else:
            kind = "a campaign" if "campaign" in path.name else "a scenario"
        check_kind(document, (), kind)
        with pytest.raises(ConfigError, match=f"is {kind}; give a tune"):
            check_kind(document, (), "a tune")


# A search may consist of a seed and faults only, so a schedule could be one by its keys.
@pytest.mark.parametrize(
    ("given", "wanted"), sorted({*permutations(READERS, 2)} - {("a schedule", "a search")})
)
def test_a_document_of_another_kind_is_recognised(given: str, wanted: str) -> None:
    read = READERS[wanted][0]
    _, name, command = READERS[given]
    says = f"{name}: is {given}; give {wanted}, or run `mavproxy-fault {command}`"
    with pytest.raises(ConfigError, match=says):
        read(EXAMPLES / name)


def test_a_misspelt_key_of_a_schedule_gets_a_suggestion() -> None:
    with pytest.raises(ConfigError, match="did you mean faults"):
        parse_schedule({"seed": 1, "fault": []})

from pathlib import Path

import pytest
import yaml

from mavproxy_fault.faults.registry import known_faults
from mavproxy_fault.schedule.entries import read_schedule
from mavproxy_fault.schedule.presets import preset_names

EXAMPLES = Path(__file__).resolve().parents[3] / "examples"
SCHEDULES = [
    path
    for path in sorted(EXAMPLES.glob("*.yaml"))
    if set(yaml.safe_load(path.read_text())) <= {"seed", "faults"}
]
DOCUMENT = EXAMPLES.parent / "docs" / "keys.md"


def test_there_are_examples() -> None:
    assert len(SCHEDULES) >= 4


@pytest.mark.parametrize("path", SCHEDULES, ids=lambda path: path.stem)
def test_an_example_is_read(path: Path) -> None:
    assert read_schedule(path).faults
    assert path.read_text().startswith("# ")


def test_every_fault_and_preset_has_its_line_in_the_documentation() -> None:
    text = DOCUMENT.read_text()
    missing = [n for n in (*known_faults(), *preset_names()) if f"### `{n}` (" not in text]
    assert missing == []

"""Examples with faults and without an autopilot fulfil their own criteria, and exit with 0."""

from pathlib import Path

import pytest

from mavproxy_fault.cli import main

EXAMPLES = Path(__file__).parents[3] / "examples"


@pytest.mark.parametrize("name", ["fusion", "test_sequence", "vision"])
def test_an_example_passes(name: str, tmp_path: Path) -> None:
    scenario, folder = str(EXAMPLES / f"{name}.yaml"), str(tmp_path / "out")
    assert main(["run", scenario, "--out", folder, "--zenoh", "off", "--no-report"]) == 0

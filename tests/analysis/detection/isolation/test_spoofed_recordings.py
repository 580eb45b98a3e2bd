"""A real recording, spoofed as `replay` spoofs it: what is said while it lasts and afterwards."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from analysis.detection import Detector
from analysis.detection.isolation.all_satellites import accumulated_jump_m
from analysis.recordings.read_recordings import read_rinex
from analysis.results import Decision
from mavproxy_fault.app.replaying.rinex_faults import faulted_lines
from mavproxy_fault.rinex.rinex_text import read_rinex_text
from mavproxy_fault.schedule.entries import parse_schedule

AT_S, FOR_S, UNTIL_S = 100, 60, 200
ROOF_M = np.array([-3962108.6836, 3381309.5672, 3668678.6720])
Spoofed = Callable[[dict[str, Any]], list[Decision]]


@pytest.fixture(scope="module")
def spoofed(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Spoofed:
    """Decisions on the first minutes of the roof antenna with a fault in them; `t_s` counts from
    its begin."""
    folder = shared_data / "gnss_static"
    lines = read_rinex_text(folder / "SEPT078M.21O")
    heads = [i for i, line in enumerate(lines) if line.startswith(">")]
    obs, nav = tmp_path_factory.mktemp("roof") / "roof.obs", folder / "SEPT078M.21P"
    obs.write_text("\n".join(lines[: heads[UNTIL_S]]) + "\n")

    def decisions(fault: dict[str, Any]) -> list[Decision]:
        entry = {**fault, "at_s": AT_S, "for_s": FOR_S}
        changed, _ = faulted_lines(obs, parse_schedule({"faults": [entry]}), [nav])
        detector = Detector()
        results, _ = detector.step(read_rinex(obs, nav, None, changed), detector.new_state())
        found = [result for result in results if isinstance(result, Decision)]
        begin_us = found[0].t_us + AT_S * 1_000_000
        return [msgspec.structs.replace(d, t_us=d.t_us - begin_us) for d in found]

    return decisions


@pytest.mark.parametrize("preset", ["gnss-meaconing", "gnss-spoof-jump"])
def test_a_jump_of_all_satellites_is_reported_and_the_position_unbounded_until_they_are_back(
    spoofed: Spoofed, preset: str
) -> None:
    found = spoofed({"preset": preset})
    assert not any(decision.alarm for decision in found if decision.t_s < 0.0)
    acting = [decision for decision in found if 0.0 <= decision.t_s < FOR_S]
    assert acting[0].alarm
    assert {decision.hypothesis for decision in acting} == {"gps"}
    assert all(decision.position_ecef_m is not None for decision in acting)
    assert all("jumped together" in decision.reason for decision in acting)
    bounds = {(d.position_sigma_m, d.hpl_m, d.vpl_m) for d in acting}
    assert bounds == {(None, None, None)}
    back = [decision for decision in found if decision.t_s >= FOR_S]
    assert all(decision.position_sigma_m is not None for decision in back)
    assert {decision.hypothesis for decision in back[1:]} == {"none"}


def test_a_satellite_excluded_with_its_system_is_readmitted_with_it(spoofed: Spoofed) -> None:
    jump = {"fault": "plant", "target": "PLANT.spoof_north_m[G]", "value": 30.0}
    found = spoofed(jump)
    acting = [decision for decision in found if 0.0 <= decision.t_s < FOR_S]
    assert {name[0] for decision in acting for name in decision.excluded} == {"G"}
    # G28 is always 3 m off: its readmission may take ten seconds and not longer.
    assert not any(decision.excluded for decision in found if decision.t_s > FOR_S + 11.0)


def test_jumps_add_up_until_the_satellites_are_back() -> None:
    north, east = np.array([0.0, 0.0, 150.0]), np.array([0.0, 200.0, 0.0])
    assert accumulated_jump_m(None, None) is None
    first = accumulated_jump_m(None, north)
    assert first is not None
    assert accumulated_jump_m(first, None) is first
    assert accumulated_jump_m(first, -1.1 * north) is None
    both = accumulated_jump_m(first, east)
    assert both is not None
    assert accumulated_jump_m(both, -(north + east)) is None


@pytest.mark.parametrize("system", ["G", "E"])
def test_with_one_system_carried_off_the_position_goes_on_with_the_other(
    spoofed: Spoofed, system: str
) -> None:
    segments = [{"at_s": 0, "for_s": FOR_S, "start": 0, "rate": 1.0}]
    target = f"PLANT.spoof_north_m[{system}]"
    found = spoofed({"fault": "plant", "target": target, "profile": {"segments": segments}})
    acting = [decision for decision in found if 10.0 <= decision.t_s < FOR_S]
    assert {decision.hypothesis for decision in acting} == {"multiple-unknown"}
    assert not any(decision.excluded for decision in acting)
    for decision in acting:
        assert {name[0] for name in decision.unused} == {system}
        assert "bounds cover both" in decision.reason
        assert decision.position_ecef_m is not None
        assert decision.position_sigma_m is not None
        assert decision.hpl_m is not None
        error_m = np.linalg.norm(np.array(decision.position_ecef_m) - ROOF_M)
        # The other system's position may be the true one as well.
        assert error_m < 4.0
        assert decision.t_s < decision.hpl_m
        assert 0.3 * decision.t_s < np.linalg.norm(decision.position_sigma_m)
    back = [decision for decision in found if decision.t_s >= FOR_S + 12.0]
    assert {decision.hypothesis for decision in back} == {"none"}

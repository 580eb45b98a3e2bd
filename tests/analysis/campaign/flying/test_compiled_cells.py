import msgspec
import pytest

from analysis.campaign.campaign_file import CampaignFile
from analysis.campaign.cell import Cell
from analysis.campaign.flying.compiled_cells import run_compiled
from mavproxy_fault.documents.errors import ConfigError

GYRO = {"id": "gyro", "fault": "bias", "target": "HIL_SENSOR.xgyro", "magnitudes": [0.1]}


def campaign(**fault: object) -> CampaignFile:
    weave = {"name": "weave", "compiled": {"duration_s": 5, "mission": {"roll_deg": 30}}}
    return msgspec.convert(
        {"subjects": ["ekf"], "scenarios": [weave], "faults": [{**GYRO, **fault}]}, CampaignFile
    )


def cells(*magnitudes: float) -> list[Cell]:
    return [
        Cell(subject="ekf", scenario="weave", fault="gyro", magnitude=m, onset=1.0, duration_s=2.0)
        for m in magnitudes
    ]


def test_a_larger_fault_gives_a_larger_excursion_and_a_zero_fault_none() -> None:
    none, small, large = run_compiled(campaign(), cells(0.0, 0.05, 2.0))
    assert none.excursion_deg == 0.0
    assert none.outcome == "unaffected"
    assert 0.0 < small.excursion_deg < large.excursion_deg
    assert large.outcome == "lost"


def test_a_cell_has_the_same_result_alone_and_in_a_batch() -> None:
    (alone,) = run_compiled(campaign(), cells(0.3))
    among = run_compiled(campaign(), cells(*[0.1] * 40, 0.3))[-1]
    assert alone.excursion_deg == among.excursion_deg


def test_a_fault_without_compiled_code_is_reported() -> None:
    with pytest.raises(ConfigError, match="not compiled"):
        run_compiled(campaign(fault="saturate"), cells(0.3))

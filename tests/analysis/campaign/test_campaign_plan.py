from pathlib import Path

import msgspec

from analysis.campaign.campaign_file import CampaignFile, SubjectChoice, read_campaign
from analysis.campaign.campaign_plan import CampaignPlan
from analysis.campaign.cell import CellResult
from analysis.flying.flight_evidence import CampaignFlight

SMALL = read_campaign(Path(__file__).parent / "small.yaml")
EXAMPLES = Path(__file__).resolve().parents[3] / "examples"
COMPILED = read_campaign(EXAMPLES / "campaign_compiled.yaml")
TWINS = {"ekf|short.yaml|1": CampaignFlight({}), "mahony|short.yaml|1": CampaignFlight({})}


def answered(cells, outcome: str) -> dict[str, CellResult]:
    return {cell.key: CellResult(cell=cell, outcome=outcome) for cell in cells}


def test_the_size_of_a_campaign_is_its_product() -> None:
    twice = msgspec.structs.replace(SMALL, seeds=(1, 2, 3), onsets=(1.0, 2.0))
    plan = CampaignPlan(twice)
    assert (plan.max_cells, plan.max_flights, len(plan.reference_jobs())) == (24, 12, 3)
    assert plan.flight_s == 6.0
    assert CampaignPlan(COMPILED).max_cells == 100_000


def test_subjects_of_the_simulator_share_their_flights() -> None:
    jobs = [next(sequence) for sequence in CampaignPlan(SMALL).job_sequences({}, TWINS)]
    assert [[cell.subject for cell in job.cells] for job in jobs] == [["ekf", "mahony"]] * 2
    assert [job.cells[0].magnitude for job in jobs] == [0.001, 2.0]


def test_an_autopilot_has_its_own_flight() -> None:
    px4 = SubjectChoice(name="px4", autopilot="px4", binary="px4")
    mixed = CampaignPlan(msgspec.structs.replace(SMALL, subjects=("ekf", px4, "mahony")))
    references = {key: CampaignFlight({}) for key in mixed.reference_jobs()}
    jobs = [next(sequence) for sequence in mixed.job_sequences({}, references)]
    assert list(references) == ["ekf|short.yaml|1", "px4|short.yaml|1"]
    assert [[cell.subject for cell in job.cells] for job in jobs] == (
        [["ekf", "mahony"]] * 2 + [["px4"]] * 2
    )
    assert (mixed.max_cells, mixed.max_flights) == (6, 4)


def test_cells_with_stored_results_are_not_flown_again() -> None:
    first = next(next(CampaignPlan(SMALL).job_sequences({}, TWINS)))
    known = answered(first.cells, "unaffected")
    (left,) = CampaignPlan(SMALL).job_sequences(known, TWINS)
    assert next(left).cells[0].magnitude == 2.0


def test_a_flight_with_missing_results_is_repeated_for_the_missing_subject() -> None:
    first = next(next(CampaignPlan(SMALL).job_sequences({}, TWINS)))
    known = answered(first.cells[:1], "unaffected")
    job = next(next(CampaignPlan(SMALL).job_sequences(known, TWINS)))
    assert [cell.subject for cell in job.cells] == ["mahony"]


def test_a_batch_of_compiled_cells_has_one_subject_fault_and_seed() -> None:
    jobs = [next(sequence) for sequence in CampaignPlan(COMPILED).job_sequences({}, {})]
    assert sum(len(job.cells) for job in jobs) == 100_000
    for job in jobs:
        assert len({(c.subject, c.scenario, c.fault, c.seed) for c in job.cells}) == 1


def bisected(campaign: CampaignFile, threshold: float, known: dict[str, CellResult]) -> int:
    """Run a critical search of a subject that breaks at a threshold; return its flights."""
    flights = 0
    for sequence in CampaignPlan(campaign).job_sequences(known, TWINS):
        job = next(sequence, None)
        while job is not None:
            flights += 1
            (cell,) = job.cells
            outcome = "lost" if cell.magnitude >= threshold else "unaffected"
            results = answered([cell], outcome)
            known |= results
            try:
                job = sequence.send(list(results.values()))
            except StopIteration:
                job = None
    return flights


def test_a_critical_search_continues_where_it_was_killed() -> None:
    campaign = msgspec.structs.replace(SMALL, find="critical", subjects=("ekf",))
    known: dict[str, CellResult] = {}
    assert bisected(campaign, 0.1, known) == 8
    whole = CampaignPlan(campaign).critical_magnitudes(known)
    for key in list(known)[5:]:
        del known[key]
    assert CampaignPlan(campaign).critical_magnitudes(known) == {}
    assert bisected(campaign, 0.1, known) == 3
    assert CampaignPlan(campaign).critical_magnitudes(known) == whole
    (critical,) = whole.values()
    assert critical.harmless < 0.1 <= critical.magnitude

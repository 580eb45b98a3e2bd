"""A real local Ray cluster of two nodes, one of which dies during the flights."""

from pathlib import Path

import msgspec
import pytest

from analysis.campaign.campaign_file import read_campaign
from analysis.campaign.campaign_plan import CampaignPlan
from analysis.campaign.campaign_run import CampaignRun
from analysis.campaign.results_store import ResultsStore
from analysis.flying.worker_pool import RayWorkerPool

ray = pytest.importorskip("ray", reason="Ray is not installed")
HERE = Path(__file__).parent
SMALL = msgspec.structs.replace(
    read_campaign(HERE / "small.yaml"), folder=str(HERE), onsets=(2.0, 2.5, 3.0)
)


@pytest.mark.timeout(600)
@pytest.mark.filterwarnings("ignore")
def test_a_killed_node_loses_no_cell(tmp_path: Path) -> None:
    from ray.cluster_utils import Cluster

    plan = CampaignPlan(SMALL)
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    second = cluster.add_node(num_cpus=1)
    fleet = RayWorkerPool(cluster.address, 300.0)
    ledger = ResultsStore(tmp_path, SMALL)
    nodes = [2]

    def kill_after_the_first(results: list[object]) -> None:
        if nodes[0] == 2:
            cluster.remove_node(second, allow_graceful=False)
            nodes[0] = 1

    try:
        CampaignRun(plan, fleet, ledger, kill_after_the_first).run_all()
    finally:
        fleet.close()
        ledger.close()
        cluster.shutdown()
    assert nodes == [1], "a node died on the way"
    assert len(ledger.results) == plan.max_cells == 12
    assert "aborted" not in {result.outcome for result in ledger.results.values()}

"""The score of each subject of a campaign with its interval, and the hash of what was flown.

The score of the monitor is the share of judged faults that it isolated, that of another subject the
share of cells that did not fail. Intervals are those of Clopper and Pearson [1]_.

References
----------
.. [1] Clopper and Pearson, Biometrika 26(4), 1934.
"""

import hashlib
import math
from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec
import numpy as np

from analysis.campaign.campaign_file import CampaignFile
from analysis.campaign.cell import CellResult
from analysis.campaign.outcomes import ABORTED
from analysis.flying.flight_evidence import MONITOR

CONFIDENCE = 0.95
HALVINGS = 50  # of an interval of shares: to 1e-15


class SubjectScore(msgspec.Struct, frozen=True):
    """How many of the flown cells a subject passed, and the bounds of their share."""

    subject: str
    passed: int
    flown: int
    low: float
    high: float

    def describe(self) -> str:
        """Return the score in a line."""
        share = f"{self.passed / self.flown:.3f}" if self.flown else "none"
        bounds = f"({self.low:.3f} to {self.high:.3f} at 95 %)"
        return f"score    {self.subject} {share} {bounds}, {self.passed} of {self.flown} cells"


def score_subjects(campaign: CampaignFile, results: Sequence[CellResult]) -> list[SubjectScore]:
    """Return the score of each subject; aborted cells do not count."""
    scores = []
    for subject in campaign.subject_names:
        own = [r for r in results if r.cell.subject == subject and r.outcome != ABORTED]
        if subject == MONITOR:
            own = [result for result in own if result.verdict != "not judged"]
            passed = sum(result.verdict == "isolated" for result in own)
        else:
            passed = sum(not campaign.fails(result) for result in own)
        scores.append(SubjectScore(subject, passed, len(own), *share_bounds(passed, len(own))))
    return scores


def share_bounds(count: int, total: int) -> tuple[float, float]:
    """Return the bounds of a share of which `count` of `total` were seen."""
    if total == 0:
        return 0.0, 1.0
    k = np.arange(total + 1)
    ways = np.array([math.lgamma(total + 1) - math.lgamma(i + 1) - math.lgamma(total - i + 1)
                     for i in range(total + 1)])  # fmt: skip

    def tail(share: float, counts: slice) -> float:
        logs = ways + k * math.log(share) + (total - k) * math.log1p(-share)
        return float(np.exp(logs[counts]).sum())

    rest = (1.0 - CONFIDENCE) / 2.0
    low = _first_share(lambda p: tail(p, slice(count, None)) > rest) if count else 0.0
    high = _first_share(lambda p: tail(p, slice(count + 1)) < rest) if count < total else 1.0
    return low, high


def _first_share(holds: Callable[[float], bool]) -> float:
    """The share from which on a condition holds, by bisection."""
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if holds(middle) else (middle, high)
    return high


def conditions_hash(campaign: CampaignFile) -> str:
    """Return the SHA-256 of all conditions of a campaign: its file without the subjects, and its
    scenario files."""
    document = msgspec.to_builtins(campaign)
    bare = {key: document[key] for key in document if key not in ("subjects", "name", "folder")}
    digest = hashlib.sha256(msgspec.json.encode(bare))
    if not campaign.compiled:
        for path in dict.fromkeys(
            campaign.scenario_arguments(name)[0] for name in campaign.scenario_names
        ):
            digest.update(Path(path).read_bytes())
    return digest.hexdigest()

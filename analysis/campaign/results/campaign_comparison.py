"""Compare two campaigns: what got worse, and is that significant?

Cells are paired by their key. For each subject and fault, the pairs whose outcome differs are
counted: without a change, worse and better are equally likely (sign test). Since many faults are
tested, the p-values are corrected by Holm's method [1]_.

References
----------
.. [1] Holm, Scandinavian Journal of Statistics 6(2), 1979.
"""

import argparse
import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from rich.table import Table
from rich.text import Text

from analysis.campaign.cell import CellResult
from analysis.campaign.outcomes import ABORTED, outcome_rank
from analysis.campaign.results_store import read_results
from mavproxy_fault.app.command_result import open_console, plain_table, print_result
from mavproxy_fault.documents.errors import ConfigError

# Tested in addition to the single faults, to find many small changes of one sign.
ALL_FAULTS = "all faults"
# Family-wise error probability of a comparison, after the correction for many faults.
SIGNIFICANCE_LEVEL = 0.05
SAME_SHARE = 0.2  # chosen: smaller relative changes of an excursion count as equal
SAME_EXCURSION = 0.5  # degrees or metres; chosen: smaller changes count as equal


class FaultChange(NamedTuple):
    """The change of a subject and fault between two campaigns.

    `worse` and `better` count pairs that differ; `examples` are the worst regressions; `p_value` is
    the probability of at least as many regressions by chance, corrected for all faults.
    """

    subject: str
    fault: str
    pairs: int
    worse: int
    better: int
    p_value: float
    examples: tuple[tuple[CellResult, CellResult], ...]

    @property
    def regressed(self) -> bool:
        """Whether it got significantly worse."""
        return self.p_value < SIGNIFICANCE_LEVEL and self.worse > self.better


def compare_folders(before: Path, after: Path, args: argparse.Namespace) -> int:
    """Print what changed; return 1 if something got significantly worse or was aborted, else 0.

    Raises
    ------
    ConfigError
        If the campaigns have no cell in common.
    """
    old, new = (
        {result.cell.key: result for result in read_results(folder)} for folder in (before, after)
    )
    # No common cell is a mistake of the user, not "nothing changed".
    changes = compare_results(old, new)
    if not changes:
        raise ConfigError(
            f"{before} and {after}: no common cells; fly the same campaign file twice"
        )
    regressed = [change for change in changes if change.regressed]
    # Without its cells a campaign cannot show that nothing got worse.
    aborted = sum(result.outcome == ABORTED for result in new.values())

    def show() -> None:
        console = open_console()
        console.print(_table(changes))
        for change in regressed:
            for earlier, later in change.examples:
                console.print(
                    f"{later.cell.key}: {earlier.outcome} -> {later.outcome}", soft_wrap=True
                )
        console.print(f"{len(regressed)} of {len(changes)} got worse")
        if aborted:
            console.print(f"{aborted} cells of {after} aborted", soft_wrap=True)

    rows = [{**change._asdict(), "regressed": change.regressed} for change in changes]
    print_result(args, {"changes": rows, "aborted": aborted}, show)
    return int(bool(regressed or aborted))


def compare_results(
    old: Mapping[str, CellResult], new: Mapping[str, CellResult]
) -> list[FaultChange]:
    """Compare all common subjects and faults; regressions come first."""
    groups: dict[tuple[str, str], list[tuple[CellResult, CellResult]]] = defaultdict(list)
    for key, earlier in old.items():
        later = new.get(key)
        # An aborted cell says nothing about the subject.
        if later is not None and ABORTED not in (earlier.outcome, later.outcome):
            groups[earlier.cell.subject, earlier.cell.fault].append((earlier, later))
            groups[earlier.cell.subject, ALL_FAULTS].append((earlier, later))
    faults = [subject for subject, fault in groups if fault != ALL_FAULTS]
    for subject in set(faults):
        # With a single fault, the sum would be the same test again.
        if faults.count(subject) == 1:
            del groups[subject, ALL_FAULTS]
    changes = [_change(names, pairs) for names, pairs in groups.items()]
    # All at once: the correction depends on the number of tests.
    corrected = holm_correction([change.p_value for change in changes])
    changes = [c._replace(p_value=p) for c, p in zip(changes, corrected, strict=True)]
    return sorted(changes, key=lambda change: (change.p_value, -change.worse))


def _change(names: tuple[str, str], pairs: Sequence[tuple[CellResult, CellResult]]) -> FaultChange:
    signs = [(compare_pair(earlier, later), earlier, later) for earlier, later in pairs]
    worse = [(earlier, later) for s, earlier, later in signs if s > 0]
    better = sum(s < 0 for s, _, _ in signs)
    differ = len(worse) + better
    # One-sided binomial test: an improvement must not fail. Without a difference p is 1.
    p = sum(math.comb(differ, k) for k in range(len(worse), differ + 1)) / 2**differ
    # The largest regressions first; three are shown.
    worse.sort(
        key=lambda pair: outcome_rank(pair[1].outcome) - outcome_rank(pair[0].outcome), reverse=True
    )
    return FaultChange(*names, len(pairs), len(worse), better, p, tuple(worse[:3]))


def compare_pair(earlier: CellResult, later: CellResult) -> int:
    """Return 1 if worse, -1 if better: by outcome, and for equal outcomes by excursion."""
    step = outcome_rank(later.outcome) - outcome_rank(earlier.outcome)
    if step:
        return 1 if step > 0 else -1
    # Angles first; if they are equal within the tolerance, positions decide.
    for before, after in (
        (earlier.excursion_deg, later.excursion_deg),
        (earlier.excursion_m, later.excursion_m),
    ):
        if before is not None and after is not None:
            # Small excursions vary by noise, large ones in proportion: use the larger tolerance.
            size = max(SAME_EXCURSION, SAME_SHARE * abs(before))
            if abs(after - before) > size:
                return 1 if after > before else -1
    return 0


def holm_correction(p_values: Sequence[float]) -> list[float]:
    """Return p-values corrected for multiple tests, in the same order."""
    order = sorted(range(len(p_values)), key=lambda i: p_values[i])
    corrected, largest = [0.0] * len(p_values), 0.0
    for position, i in enumerate(order):
        # Holm's corrected p-values must not decrease.
        largest = max(largest, (len(p_values) - position) * p_values[i])
        corrected[i] = min(1.0, largest)
    return corrected


def _table(changes: Sequence[FaultChange]) -> Table:
    numbers = ("pairs", "worse", "better", "p")
    table = plain_table("subject", "fault", *numbers, "", right=numbers)
    for change in changes:
        mark = Text("worse" if change.regressed else "", "red")
        counts = (str(change.pairs), str(change.worse), str(change.better))
        table.add_row(change.subject, change.fault, *counts, f"{change.p_value:.3g}", mark)
    return table

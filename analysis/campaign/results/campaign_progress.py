"""Progress of a campaign on the terminal: completed cells, time left, worst outcome so far."""

import sys

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from analysis.campaign.cell import CellResult
from analysis.campaign.outcomes import outcome_rank


class CampaignProgress:
    """A progress bar on a terminal; no output elsewhere."""

    def __init__(self, cells: int, known: int) -> None:
        self._bar = Progress(
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.fields[worst]}", markup=False),
            console=Console(stderr=True),
            transient=True,
            # Nothing is drawn into a file or a pipe.
            disable=not sys.stderr.isatty(),
        )
        # Cells with stored results count as completed.
        self._task = self._bar.add_task("", total=cells, completed=known, worst="")
        self._worst: CellResult | None = None

    def __enter__(self) -> "CampaignProgress":
        self._bar.start()
        return self

    def __exit__(self, *raised: object) -> None:
        self._bar.stop()

    def show(self, results: list[CellResult]) -> None:
        """Add completed cells."""
        for result in results:
            if self._worst is None or outcome_rank(result.outcome) > outcome_rank(
                self._worst.outcome
            ):
                self._worst = result
        worst = self._worst
        text = "" if worst is None else f"worst: {worst.outcome} ({worst.cell.fault})"
        self._bar.update(self._task, advance=len(results), worst=text)

"""A cell flown by a real autopilot: one `mavproxy-fault run --autopilot`, and its run folder."""

import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from analysis.autopilots.flight_process import fly_in_process
from analysis.campaign.cell import Flown, verdict_of
from analysis.campaign.flying.autopilot_evidence import evidence_of


def fly_autopilot(
    subject: str,
    run: Sequence[str],
    schedule: dict[str, Any],
    folder: Path,
    *,
    kept: bool,
) -> Flown:
    """Fly a cell; arguments and errors as `fly_in_process` has them."""
    started_s = time.monotonic()
    flown = fly_in_process(subject, run, schedule, folder, kept=kept)
    evidence, flown_s = evidence_of(flown)
    verdict = verdict_of(json.loads((flown / "summary.json").read_text())["faults"])
    wall_s = time.monotonic() - started_s
    return Flown({subject: evidence}, {}, flown_s, wall_s, str(flown), verdict)

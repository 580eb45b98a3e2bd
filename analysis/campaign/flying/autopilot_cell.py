"""A cell flown by a real autopilot: one `mavproxy-fault run --autopilot`, and its run folder."""

import json
import shutil
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from analysis.autopilots.flight_process import fly_in_process
from analysis.campaign.cell import Flown, verdict_of
from analysis.campaign.flying.autopilot_evidence import evidence_of
from mavproxy_fault.documents.errors import ConfigError

TRIES = 3  # on a busy machine an operator's time-outs may end a flight before its fault


def fly_autopilot(
    subject: str,
    run: Sequence[str],
    schedule: dict[str, Any],
    folder: Path,
    *,
    kept: bool,
) -> Flown:
    """Fly a cell; arguments and errors as `fly_in_process` has them.

    Raises
    ------
    ConfigError
        If no flight came of it in several tries: no take-off, or a fault that never acted.
    """
    started_s = time.monotonic()
    for _ in range(TRIES):
        flown = fly_in_process(subject, run, schedule, folder, kept=kept)
        summary = json.loads((flown / "summary.json").read_text())
        took_off = "take-off" in summary["autopilot"]["moments_s"]
        # Nothing can be said of a fault that never was, and a twin that never flew is none.
        if took_off and (summary["faults"] or not schedule["faults"]):
            evidence, flown_s = evidence_of(flown)
            wall_s = time.monotonic() - started_s
            verdict = verdict_of(summary["faults"])
            return Flown({subject: evidence}, {}, flown_s, wall_s, str(flown), verdict)
        shutil.rmtree(flown)
    what = "the fault never acted" if took_off else "it never left the ground"
    why = summary["autopilot"]["ended_early"]
    raise ConfigError(f"{subject}: {what}, {TRIES} times; {why}")

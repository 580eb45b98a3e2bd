"""Checks of the log and its links: corrupted parts, lost frames, silences."""

import re

from analysis.report.curves.recording import FlightData, Windows
from analysis.report.judging.check_limits import Thresholds
from analysis.report.judging.checks import FAIL, NONE, PASS, WARN, CheckLimits, FlightCheck

DAMAGE = re.compile("corrupted|not read")
MAX_LOST_SHARE = 0.9  # chosen: a higher share means that several links are merged in one log
AUTOPILOT = 1  # MAV_COMP_ID_AUTOPILOT1
FEWEST_FRAMES = 500  # chosen: fewer frames of a sender are too few for a loss rate


def run_checks(recording: FlightData, th: Thresholds, armed: Windows | None) -> list[FlightCheck]:
    """Check the log, and each link."""
    return [_log_integrity(recording, th), *_links(recording, th)]


def _log_integrity(recording: FlightData, th: Thresholds) -> FlightCheck:
    limits = CheckLimits(*th.broken_bytes_percent, "%")
    # Notes by the reader of the log.
    damage = [note for note in recording.notes if DAMAGE.search(note)]
    if damage:
        return FlightCheck("log is complete", WARN, "; ".join(damage))
    if recording.size == 0:
        return FlightCheck("log is complete", PASS, "no part is corrupted or missing")
    percent = 100 * recording.junk_bytes / recording.size
    verdict = FAIL if percent > limits.fail else WARN if percent > limits.warn else PASS
    evidence = f"{recording.junk_bytes} of {recording.size} bytes ({percent:.2g} %) are not frames"
    return FlightCheck("log is complete", verdict, evidence, limits.text())


def _links(recording: FlightData, th: Thresholds) -> list[FlightCheck]:
    """Losses and silences of the vehicles' senders with enough frames."""
    vehicles = set(recording.systems)
    # Where a vehicle's autopilot sends, its companions and cameras judge no flight.
    piloted = {link.system for link in recording.links if link.component == AUTOPILOT}
    lost, silent = CheckLimits(*th.frames_lost_percent, "%"), CheckLimits(*th.silence_s, "s")
    checks = []
    for link in recording.links:
        if link.frames < FEWEST_FRAMES or link.system not in vehicles:
            continue
        if link.system in piloted and link.component != AUTOPILOT:
            continue
        share = link.lost / (link.frames + link.lost)
        percent = 100 * share
        bad = percent > lost.fail or link.longest_gap_s > silent.fail
        doubtful = percent > lost.warn or link.longest_gap_s > silent.warn
        # Merged links interleave their sequence numbers, so nearly all frames seem lost.
        mixed = share > MAX_LOST_SHARE
        name = f"link from {link.system}/{link.component}"
        name = f"{name} in {link.log}" if link.log else name
        verdict = NONE if mixed else FAIL if bad else WARN if doubtful else PASS
        evidence = (
            "several links are merged in one log; losses cannot be counted"
            if mixed
            else f"{link.lost} of {link.frames + link.lost} frames lost ({percent:.2g} %), "
            f"longest silence {link.longest_gap_s:.1f} s"
        )
        limit = f"{lost.text()}; silence: {silent.text()}"
        checks.append(FlightCheck(name, verdict, evidence, limit, panel="link-lost"))
    return checks

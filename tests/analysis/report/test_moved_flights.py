"""A flight is judged alike wherever it took place, and whatever became of its log's timestamps."""

from collections.abc import Callable
from pathlib import Path

import pytest

from analysis.report.flight_verdict import FlightAssessment, assess_flight
from analysis.report.judging.check_limits import Thresholds
from analysis.report.recordings.flight_sources import read_flight
from tests.analysis.report.short_flights import BOOT_US, FLIGHTS, HERE, NOON_US, Stamp

HOUR_US, DAY_US = 3_600_000_000, 86_400_000_000
SECOND_S = 0.25  # rows without a time are placed between those of the receiver, five a second
HALF_US = 28_000_000  # of the flight, in which nothing is judged that ends before


def judged(path: Path, log: bytes) -> FlightAssessment:
    path.write_bytes(log)
    return assess_flight(read_flight([path], ()), Thresholds())


def from_half_on(change: Callable[[int], int]) -> Stamp:
    """Stamps that change in the middle of the flight."""

    def moved(t_us: int, number: int) -> int:
        begin = NOON_US if t_us >= NOON_US else BOOT_US
        return change(t_us) if t_us - begin > HALF_US else t_us

    return moved


MOVED: dict[str, Stamp] = {
    "an hour back": from_half_on(lambda t_us: t_us - HOUR_US),
    "40 s back": from_half_on(lambda t_us: t_us - 40_000_000),
    "10 days on": from_half_on(lambda t_us: t_us + 10 * DAY_US),
    "1970": lambda t_us, number: t_us % (DAY_US // 24),
    "zero": lambda t_us, number: 0,
    "zero later": from_half_on(lambda t_us: 0),
}


def summary(found: FlightAssessment) -> dict[str, str]:
    return {check.name: check.verdict for check in found.checks}


@pytest.fixture(scope="module")
def usual(tmp_path_factory: pytest.TempPathFactory) -> dict[str, FlightAssessment]:
    folder = tmp_path_factory.mktemp("usual")
    return {kind: judged(folder / f"a{kind}", make()) for kind, make in FLIGHTS.items()}


@pytest.mark.parametrize("moved", [*MOVED, "none"])
@pytest.mark.parametrize("kind", FLIGHTS)
def test_moved_timestamps_change_no_verdict_and_no_window(
    kind: str, moved: str, usual: dict[str, FlightAssessment], tmp_path: Path
) -> None:
    make, right = FLIGHTS[kind], usual[kind]
    log = make(stamped=False) if moved == "none" else make(MOVED[moved])
    found = judged(tmp_path / f"a{kind}", log)
    assert right.verdict == "FAIL"
    assert summary(found) == summary(right)
    for check, other in zip(found.checks, right.checks, strict=True):
        assert len(check.windows) == len(other.windows), check.name
        for window, usual_window in zip(check.windows, other.windows, strict=True):
            assert window == pytest.approx(usual_window, abs=SECOND_S), check.name
    length = right.flight.recording.duration_s
    assert found.flight.recording.duration_s == pytest.approx(length, abs=2 * SECOND_S)


@pytest.mark.parametrize("kind", FLIGHTS)
def test_a_flight_across_the_antimeridian_has_the_same_numbers(
    kind: str, usual: dict[str, FlightAssessment], tmp_path: Path
) -> None:
    far = judged(tmp_path / f"a{kind}", FLIGHTS[kind](place=(HERE[0], 179.9999)))
    tracks = [track.lon_deg for track in far.flight.recording.tracks if track.on_earth]
    assert min(lon.min() for lon in tracks) < -179.0 < 179.0 < max(lon.max() for lon in tracks)
    assert [(c.name, c.verdict) for c in far.checks] == [*summary(usual[kind]).items()]
    facts = [one.summary["flight"] for one in (far, usual[kind])]
    assert facts[0] == facts[1]
    outcomes = [one.summary["outcome"]["outcome"] for one in (far, usual[kind])]
    assert outcomes[0] == outcomes[1]
    for check, other in zip(far.checks, usual[kind].checks, strict=True):
        assert check.windows == other.windows

"""Campaign files (YAML): subjects under test, scenarios, and faults."""

import math
from functools import cached_property
from itertools import combinations, product
from pathlib import Path
from typing import Any, Literal

import msgspec

from analysis.campaign.cell import CellResult
from analysis.campaign.outcomes import ABORTED, RANKS, OutcomeLimits, outcome_rank
from analysis.estimators import estimator_names
from analysis.flying.flight_evidence import MONITOR
from analysis.flying.onset import onset_keys
from analysis.monitor.pipeline import MonitorConfig, monitor_detectors
from analysis.scoring.criteria import VehicleCriteria
from analysis.scoring.requirements import parse_requirements
from analysis.search.space.test_file import TestFile
from mavproxy_fault.documents.document_check import DocumentCheck, Section, decode
from mavproxy_fault.documents.document_kind import check_kind
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.parameter_list import read_parameters
from mavproxy_fault.documents.suggestion import suggest_known
from mavproxy_fault.documents.yaml_document import read_document
from mavproxy_fault.schedule.entries import parse_entry

MAGNITUDE = "value"  # the key of a fault that a magnitude sets by default


class Magnitudes(Section, frozen=True):
    """Magnitudes from `low` to `high`; in a critical search, the interval to search."""

    low: float
    high: float
    count: int = 5
    spacing: Literal["log", "linear"] = "log"

    def __post_init__(self) -> None:
        if not self.low < self.high:
            raise ValueError(f"low = {self.low} must be below high = {self.high}")
        # A logarithm needs a positive start.
        if self.spacing == "log" and self.low <= 0.0:
            raise ValueError(f"low = {self.low} must be above 0; else use spacing: linear")
        if self.count < 2:
            raise ValueError(f"count = {self.count} must be 2 or more")

    def interpolate(self, share: float) -> float:
        """Return the magnitude at a share (0 to 1) of the interval, by the spacing."""
        if self.spacing == "linear":
            return self.low + share * (self.high - self.low)
        return math.exp(math.log(self.low) + share * math.log(self.high / self.low))

    def spaced_values(self) -> list[float]:
        """Return all magnitudes, rounded to four digits."""
        # Four digits keep names and keys short, and the same after a restart.
        return [float(f"{self.interpolate(i / (self.count - 1)):.4g}") for i in range(self.count)]


class FaultChoice(Section, frozen=True):
    """A fault or preset, or several `faults` at once; `magnitudes` replace its key `sets`; `also`
    holds further keys. A part without magnitudes takes those of the whole."""

    id: str | None = None
    fault: str | None = None
    preset: str | None = None
    target: str | list[str] | None = None
    magnitudes: tuple[float, ...] | Magnitudes | None = None
    sets: str = MAGNITUDE
    also: dict[str, Any] = msgspec.field(default_factory=dict)
    faults: tuple["FaultChoice", ...] = ()

    def __post_init__(self) -> None:
        if [self.fault is None, self.preset is None, not self.faults].count(False) != 1:
            raise ValueError("needs exactly one of fault, preset and faults")

    @property
    def name(self) -> str:
        """The name of the fault in results."""
        target = self.target if isinstance(self.target, str) else "+".join(self.target or [])
        if self.faults and not self.id:
            return " + ".join(part.name for part in self.faults)
        return self.id or " ".join(filter(None, (self.fault or self.preset, target)))

    def magnitude_list(self) -> list[float | None]:
        """Return the magnitudes of a grid; [None] for a fault without magnitudes."""
        if self.magnitudes is None:
            return [None]
        if isinstance(self.magnitudes, Magnitudes):
            return list(self.magnitudes.spaced_values())
        return list(self.magnitudes)

    def interval(self) -> Magnitudes:
        """Return the interval in which a critical magnitude is searched.

        Raises
        ------
        ValueError
            If the fault has no magnitudes.
        """
        if isinstance(self.magnitudes, Magnitudes):
            return self.magnitudes
        if not self.magnitudes:
            raise ValueError(f"{self.name}: magnitudes are missing; give {{low: , high: }}")
        low, high = min(self.magnitudes), max(self.magnitudes)
        # Logarithmic if possible: effects of faults span decades.
        return Magnitudes(low=low, high=high, spacing="log" if low > 0.0 else "linear")

    def entries(
        self, magnitude: float | None, start: dict[str, Any], duration_s: float
    ) -> list[dict[str, Any]]:
        """Build the schedule entries of the fault; `start` has the keys of its onset."""
        if self.faults:
            return [
                entry
                for part in self.faults
                for entry in part.entries(
                    part.magnitude_list()[0] if part.magnitudes else magnitude, start, duration_s
                )
            ]
        entry: dict[str, Any] = {"id": self.name.replace(" ", "-"), **self.also}
        for key in ("fault", "preset", "target"):
            if getattr(self, key) is not None:
                entry[key] = getattr(self, key)
        if magnitude is not None:
            entry[self.sets] = magnitude
        # Last, so that `also` cannot move the fault.
        return [{**entry, **start, "for_s": duration_s}]


class SubjectChoice(Section, frozen=True):
    """An autopilot under test, as `mavproxy-fault run` takes it; `parameters` is a file relative to
    the campaign file, `arguments` are further arguments of `run`."""

    name: str
    autopilot: Literal["ardupilot", "ardupilot:copter", "ardupilot:plane", "px4"]
    binary: str
    parameters: str = ""
    arguments: tuple[str, ...] = ()

    def options(self, folder: str | Path) -> list[str]:
        """Return the arguments of `run`, for a campaign file in `folder`."""
        arguments = ["--autopilot", self.autopilot, "--binary", self.binary]
        if self.parameters:
            arguments += ["--parameters", str(Path(folder) / self.parameters)]
        return [*arguments, *self.arguments]


class CompiledScenario(Section, frozen=True):
    """A compiled flight of the search's own aircraft; `compiled` holds keys of a test file."""

    name: str
    compiled: dict[str, Any]


class Combination(Section, frozen=True):
    """Faults at once, in addition to each alone: all pairs, or a covering array, in which each two
    values of the campaign's lists occur together in one flight at least."""

    faults: Literal[2] = 2
    cover: Literal["all", "pairs"] = "all"


class CampaignFile(Section, frozen=True, dict=True):
    """A campaign file; the number of cells is the product of its lists.

    `vary` lists values of scenario keys, such as wind and start, by their paths; `requirements`
    are judged in each flight, `criteria` limit what happens to the vehicle of an autopilot;
    `combine` adds pairs of faults; `severity` gives outcomes the user's classes in an FMEA.
    """

    subjects: tuple[str | SubjectChoice, ...]
    scenarios: tuple[str | CompiledScenario, ...]
    faults: tuple[FaultChoice, ...]
    vary: dict[str, tuple[float, ...]] = msgspec.field(default_factory=dict)
    name: str = "campaign"
    onsets: tuple[float | str, ...] = (20.0,)
    durations_s: tuple[float, ...] = (10.0,)
    seeds: tuple[int, ...] = (1,)
    find: Literal["outcomes", "critical"] = "outcomes"
    limits: OutcomeLimits = OutcomeLimits()
    criteria: VehicleCriteria = VehicleCriteria()
    keep: Literal["none", "interesting", "all"] = "none"
    flight_limit_s: float = 600.0
    requirements: Any = None
    combine: Combination | Literal[2] | None = None
    severity: dict[str, str] = msgspec.field(default_factory=dict)
    folder: str = "."

    def __post_init__(self) -> None:
        for name in ("subjects", "scenarios", "faults", "onsets", "durations_s", "seeds"):
            if not getattr(self, name):
                raise ValueError(f"{name} is empty; give at least one")
        for onset in self.onsets:
            onset_keys(onset)
        for name in self.severity:
            if name not in RANKS:
                raise ValueError(f"severity.{name} is unknown; {suggest_known(name, [*RANKS])}")
        parse_requirements(self.requirements)
        if self.combine and (self.find == "critical" or self.compiled):
            raise ValueError("combine needs find: outcomes and scenario files")
        for path, values in self.vary.items():
            if not values:
                raise ValueError(f"vary.{path} is empty; give at least one value")
        if self.vary and self.compiled:
            raise ValueError("vary needs scenario files; compiled scenarios have their own keys")
        # Names are keys of results, so two faults of one name would be merged.
        ids = [fault.name for fault in self.faults]
        for name in ids:
            if ids.count(name) > 1:
                raise ValueError(f"faults: {name} occurs twice; give each an id")
        if self.find == "critical":
            for fault in self.faults:
                fault.interval()

    @property
    def compiled(self) -> bool:
        """Whether the campaign flies compiled flights, without frames and proxy."""
        return isinstance(self.scenarios[0], CompiledScenario)

    def autopilot(self, name: str) -> SubjectChoice | None:
        """Return the autopilot with this subject name; None for an estimator or the monitor."""
        chosen = [s for s in self.subjects if isinstance(s, SubjectChoice) and s.name == name]
        return chosen[0] if chosen else None

    @property
    def scenario_names(self) -> list[str]:
        """The names of the scenarios, followed by varied values as `run --set` takes them."""
        if self.compiled:
            return [s.name for s in self.scenarios if isinstance(s, CompiledScenario)]
        varied = [[f"{path}={value:g}" for value in values] for path, values in self.vary.items()]
        return [" ".join(map(str, arguments)) for arguments in product(self.scenarios, *varied)]

    def scenario_arguments(self, name: str) -> list[str]:
        """Return the arguments of `run` for a scenario by its name in results."""
        file = next(str(s) for s in self.scenarios if name == s or name.startswith(f"{s} "))
        arguments = [str(Path(self.folder) / file)]
        # Neither paths in a scenario nor numbers contain blanks.
        for change in name[len(file) :].split():
            arguments += ["--set", change]
        return arguments

    @property
    def subject_names(self) -> list[str]:
        """The subjects' names in results."""
        return [s if isinstance(s, str) else s.name for s in self.subjects]

    @property
    def fail_from(self) -> str:
        """The mildest outcome that fails a cell; `aborted` if only aborted cells fail."""
        # A bisection needs bad outcomes, so they are no failure there unless the file says so.
        bisected = ABORTED if self.find == "critical" else self.limits.worse_from
        return self.limits.fail_from or bisected

    def fails(self, result: CellResult) -> bool:
        """Whether a cell fails: aborted, by its outcome, a criterion or a violated requirement."""
        violated = any(one.met is False for one in result.requirements)
        if result.outcome == ABORTED or result.failed or violated:
            return True
        worst = outcome_rank(result.outcome)
        return self.fail_from != ABORTED and worst >= outcome_rank(self.fail_from)

    @cached_property
    def pairs(self) -> tuple[FaultChoice, ...]:
        """The pairs of faults at once, each with one magnitude of either."""
        sized = [
            (fault, magnitude) for fault in self.faults for magnitude in fault.magnitude_list()
        ]
        return tuple(
            _join_faults(one, other)
            for one, other in (combinations(sized, 2) if self.combine else ())
            if one[0] is not other[0]
        )

    @cached_property
    def pair_names(self) -> frozenset[str]:
        """The names of the pairs in results."""
        return frozenset(pair.name for pair in self.pairs)

    @property
    def cover(self) -> str:
        """Which pairs are flown."""
        return self.combine.cover if isinstance(self.combine, Combination) else "all"

    @cached_property
    def all_faults(self) -> dict[str, FaultChoice]:
        """The faults and pairs by their names in results."""
        return {fault.name: fault for fault in (*self.faults, *self.pairs)}


def _join_faults(*sized: tuple[FaultChoice, float | None]) -> FaultChoice:
    """Return faults at once, each with a magnitude."""
    parts = tuple(
        msgspec.structs.replace(fault, id=fault.name, magnitudes=None if m is None else (m,))
        for fault, m in sized
    )
    names = (f"{fault.name} {'' if m is None else f'{m:g}'}".rstrip() for fault, m in sized)
    return FaultChoice(id=" + ".join(names), faults=parts)


def read_campaign(path: Path | str) -> CampaignFile:
    """Read a campaign file, and check every fault like a schedule entry.

    Raises
    ------
    ConfigError
        If the file cannot be read, or a key or value is wrong.
    """
    document = read_document(path)
    keys = check_kind(document, CampaignFile.__struct_fields__, "a campaign")
    # Scenario paths are relative to the campaign file.
    data = {**keys, "folder": str(Path(path).parent)}
    campaign = decode(document._replace(data=data), CampaignFile)
    # Results of compiled scenarios and of files cannot be compared.
    kinds = {isinstance(scenario, CompiledScenario) for scenario in campaign.scenarios}
    if len(kinds) > 1:
        raise ConfigError(f"{path}: scenarios mix compiled ones and files; use one kind only")
    for i, scenario in enumerate(campaign.scenarios):
        if isinstance(scenario, CompiledScenario):
            decode(document, TestFile, ("scenarios", i, "compiled"))
    known = [MONITOR, *estimator_names(), *monitor_detectors(MonitorConfig())]
    check = DocumentCheck(document.where, document.lines)
    for i, subject in enumerate(campaign.subjects):
        if isinstance(subject, str) and subject not in known:
            check.wrong(("subjects", i), f"= {subject} is unknown; {suggest_known(subject, known)}")
        elif not isinstance(subject, str) and subject.parameters:
            # Checked here, before each flight fails for the same reason.
            read_parameters(str(Path(campaign.folder) / subject.parameters))
    check.finish()
    # Parsed at the first magnitude, so that errors show before the first flight.
    for i, fault in enumerate(campaign.faults):
        where = f"{path}:{document.lines.get(('faults', i), 1)}: faults[{i}]"
        for entry in fault.entries(fault.magnitude_list()[0], {"at_s": 0.0}, 1.0):
            parse_entry(entry, where)
    return campaign

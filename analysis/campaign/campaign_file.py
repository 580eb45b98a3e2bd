"""Campaign files (YAML): who is asked, in which flights, about which faults."""

import math
from itertools import product
from pathlib import Path
from typing import Any, Literal

import msgspec

from analysis.autopilots.user_parameters import read_parameters
from analysis.campaign.cell import MONITOR
from analysis.campaign.outcomes import OutcomeLimits
from analysis.estimators import estimator_names
from analysis.monitor.pipeline import MonitorConfig, monitor_detectors
from analysis.search.space.test_file import TestFile
from mavproxy_fault.documents.document_check import DocumentCheck, decode
from mavproxy_fault.documents.document_kind import refuse_other_kinds
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.suggestion import suggest_known
from mavproxy_fault.documents.yaml_document import read_document
from mavproxy_fault.schedule.entries import parse_entry

MAGNITUDE = "value"  # the key of a fault that a magnitude sets, unless it says otherwise
PHASES = ("hover", "turn", "climb", "descent", "level", "landing")


class _Section(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of the sections: unknown keys are errors."""


class Magnitudes(_Section, frozen=True):
    """Magnitudes from `low` to `high`; of a critical search, the interval that is searched."""

    low: float
    high: float
    count: int = 5
    spacing: Literal["log", "linear"] = "log"

    def __post_init__(self) -> None:
        if not self.low < self.high:
            raise ValueError(f"low = {self.low} is not below high = {self.high}; low < high")
        # A logarithm needs a positive start.
        if self.spacing == "log" and self.low <= 0.0:
            raise ValueError(f"low = {self.low} is not positive; above 0, or spacing: linear")
        if self.count < 2:
            raise ValueError(f"count = {self.count} is too few; 2 or more")

    def interpolate(self, share: float) -> float:
        """The magnitude at a share (0 to 1) of the way, by the spacing."""
        if self.spacing == "linear":
            return self.low + share * (self.high - self.low)
        return math.exp(math.log(self.low) + share * math.log(self.high / self.low))

    def spaced_values(self) -> list[float]:
        """All of them, rounded to four digits."""
        # Four digits: names and keys stay short, and the same after a restart.
        return [float(f"{self.interpolate(i / (self.count - 1)):.4g}") for i in range(self.count)]


class FaultChoice(_Section, frozen=True):
    """A fault or preset; `magnitudes` replace its key `sets`; `also` are its further keys."""

    id: str | None = None
    fault: str | None = None
    preset: str | None = None
    target: str | list[str] | None = None
    magnitudes: tuple[float, ...] | Magnitudes | None = None
    sets: str = MAGNITUDE
    also: dict[str, Any] = {}

    def __post_init__(self) -> None:
        if (self.fault is None) == (self.preset is None):
            raise ValueError("exactly one of fault and preset is needed")

    @property
    def name(self) -> str:
        """Its name in results."""
        target = self.target if isinstance(self.target, str) else "+".join(self.target or [])
        return self.id or " ".join(filter(None, (self.fault or self.preset, target)))

    def magnitude_list(self) -> list[float | None]:
        """The magnitudes of a grid; one that is None for a fault without."""
        if self.magnitudes is None:
            return [None]
        if isinstance(self.magnitudes, Magnitudes):
            return list(self.magnitudes.spaced_values())
        return list(self.magnitudes)

    def interval(self) -> Magnitudes:
        """Where a critical magnitude is sought.

        Raises
        ------
        ValueError
            If the fault has no magnitudes.
        """
        if isinstance(self.magnitudes, Magnitudes):
            return self.magnitudes
        if not self.magnitudes:
            # One magnitude only would be no interval.
            raise ValueError(f"{self.name}: magnitudes are missing; {{low: , high: }}")
        low, high = min(self.magnitudes), max(self.magnitudes)
        # Logarithmic where it can be: effects of faults span decades.
        return Magnitudes(low=low, high=high, spacing="log" if low > 0.0 else "linear")

    def entry(self, magnitude: float | None, onset_s: float, duration_s: float) -> dict[str, Any]:
        """The entry of a schedule."""
        entry: dict[str, Any] = {"id": self.name.replace(" ", "-"), **self.also}
        for key in ("fault", "preset", "target"):
            if getattr(self, key) is not None:
                entry[key] = getattr(self, key)
        if magnitude is not None:
            entry[self.sets] = magnitude
        # Last, so that no further key can move the fault.
        return {**entry, "at_s": onset_s, "for_s": duration_s}


class SubjectChoice(_Section, frozen=True):
    """An autopilot under test, as `mavproxy-fault run` takes it; the file of its `parameters` lies
    beside the campaign's, and `arguments` are further ones."""

    name: str
    autopilot: str
    binary: str
    parameters: str = ""
    arguments: tuple[str, ...] = ()

    def options(self, folder: str | Path) -> list[str]:
        """The words that `run` takes, for a campaign whose file lies in `folder`."""
        words = ["--autopilot", self.autopilot, "--binary", self.binary]
        if self.parameters:
            words += ["--parameters", str(Path(folder) / self.parameters)]
        return [*words, *self.arguments]


class CompiledScenario(_Section, frozen=True):
    """A flight of the search's compiled fixed wing; `compiled` holds keys of a search's file."""

    name: str
    compiled: dict[str, Any]


class CampaignFile(_Section, frozen=True):
    """A whole campaign file; the number of cells is the product of its lists.

    `vary` are values of the scenarios, such as wind and start, by their paths.
    """

    subjects: tuple[str | SubjectChoice, ...]
    scenarios: tuple[str | CompiledScenario, ...]
    faults: tuple[FaultChoice, ...]
    vary: dict[str, tuple[float, ...]] = {}
    name: str = "campaign"
    onsets: tuple[float | str, ...] = (20.0,)
    durations_s: tuple[float, ...] = (10.0,)
    seeds: tuple[int, ...] = (1,)
    find: Literal["outcomes", "critical"] = "outcomes"
    limits: OutcomeLimits = OutcomeLimits()
    keep: Literal["none", "interesting", "all"] = "none"
    flight_limit_s: float = 600.0
    folder: str = "."

    def __post_init__(self) -> None:
        for name in ("subjects", "scenarios", "faults", "onsets", "durations_s", "seeds"):
            if not getattr(self, name):
                raise ValueError(f"{name} is empty; at least one is needed")
        for onset in self.onsets:
            if isinstance(onset, str) and onset not in PHASES:
                raise ValueError(f"onsets: {onset} is unknown; seconds or {', '.join(PHASES)}")
        for path, values in self.vary.items():
            if not values:
                raise ValueError(f"vary.{path} is empty; at least one value is needed")
        if self.vary and self.compiled:
            raise ValueError("vary is for scenarios of files; a compiled one has its own keys")
        # Names are keys of results: two faults of one name would be one.
        ids = [fault.name for fault in self.faults]
        for name in ids:
            if ids.count(name) > 1:
                raise ValueError(f"faults: {name} stands twice; give them an id each")
        if self.find == "critical":
            for fault in self.faults:
                fault.interval()

    @property
    def compiled(self) -> bool:
        """Whether the compiled kernels fly it."""
        return isinstance(self.scenarios[0], CompiledScenario)

    def autopilot(self, name: str) -> SubjectChoice | None:
        """The autopilot of a subject's name; None for an estimator or the monitor."""
        chosen = [s for s in self.subjects if isinstance(s, SubjectChoice) and s.name == name]
        return chosen[0] if chosen else None

    @property
    def scenario_names(self) -> list[str]:
        """The scenarios by name; what is varied stands behind, as `run --set` takes it."""
        if self.compiled:
            return [s.name for s in self.scenarios if isinstance(s, CompiledScenario)]
        varied = [[f"{path}={value:g}" for value in values] for path, values in self.vary.items()]
        return [" ".join(map(str, words)) for words in product(self.scenarios, *varied)]

    def scenario_arguments(self, name: str) -> list[str]:
        """The words of `run` that fly a scenario by its name in results."""
        file = next(str(s) for s in self.scenarios if name == s or name.startswith(f"{s} "))
        words = [str(Path(self.folder) / file)]
        # Neither a path in a scenario nor a number has a blank in it.
        for change in name[len(file) :].split():
            words += ["--set", change]
        return words

    @property
    def subject_names(self) -> list[str]:
        """The subjects' names in results."""
        return [s if isinstance(s, str) else s.name for s in self.subjects]

    def fault(self, name: str) -> FaultChoice:
        """A fault by its name in results."""
        return next(fault for fault in self.faults if fault.name == name)


def read_campaign(path: Path | str) -> CampaignFile:
    """Read a campaign file; every fault is checked as a schedule's entry is.

    Raises
    ------
    ConfigError
        If it cannot be read, or a key or value is wrong.
    """
    document = read_document(path)
    if not isinstance(document.data, dict):
        raise ConfigError(f"{path}: holds no keys; a campaign file is a YAML mapping")
    refuse_other_kinds(document.data, CampaignFile.__struct_fields__, str(path), "a campaign")
    # Scenarios lie beside the campaign's file.
    data = {**document.data, "folder": str(Path(path).parent)}
    campaign = decode(document._replace(data=data), CampaignFile)
    # One way of flying in a campaign: the numbers of both would not compare.
    kinds = {isinstance(scenario, CompiledScenario) for scenario in campaign.scenarios}
    if len(kinds) > 1:
        raise ConfigError(f"{path}: scenarios mix compiled ones and files; one kind in a campaign")
    for i, scenario in enumerate(campaign.scenarios):
        if isinstance(scenario, CompiledScenario):
            decode(document, TestFile, ("scenarios", i, "compiled"))
    known = [MONITOR, *estimator_names(), *monitor_detectors(MonitorConfig())]
    check = DocumentCheck(document.where, document.lines)
    for i, subject in enumerate(campaign.subjects):
        if isinstance(subject, str) and subject not in known:
            check.wrong(("subjects", i), f"= {subject} is unknown; {suggest_known(subject, known)}")
        elif not isinstance(subject, str) and subject.parameters:
            # Before the first flight: each would end for the same reason.
            read_parameters(str(Path(campaign.folder) / subject.parameters))
    check.finish()
    # As a schedule's entry, at the first magnitude: errors come before the first flight.
    for i, fault in enumerate(campaign.faults):
        where = f"{path}:{document.lines.get(('faults', i), 1)}: faults[{i}]"
        parse_entry(fault.entry(fault.magnitude_list()[0], 0.0, 1.0), where)
    return campaign

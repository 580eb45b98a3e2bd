"""Requirements on a flight in Signal Temporal Logic (STL), and by how much a flight meets them.

A formula is evaluated on signals of one time grid by `sentil`. Its robustness is the distance to
the boundary between met and violated, in the unit of the signals (Fainekos and Pappas, Theoretical
Computer Science 410, 2009; Donze and Maler, FORMATS 2010). docs/requirements.md lists the signals.
"""

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from importlib.resources import files
from typing import Any, Literal, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.suggestion import suggest_known
from mavproxy_fault.documents.yaml_document import read_yaml

Vector = NDArray[np.float64]
TRUE = 1e6  # the value of a true signal and, negated, of a false one: sentil needs finite numbers
LOGICAL = 1e5  # a robustness beyond this comes from true and false alone: it is no distance

# A signal's unit is that of the end of its name.
NUMBERS = (
    "height_m", "north_m", "east_m", "distance_m", "speed_mps", "climb_mps", "tilt_deg",
    "impact_mps", "position_error_m", "attitude_error_deg", "fence_margin_m",
)  # fmt: skip
TRUTHS = (
    "armed", "taking_off", "landing", "landed", "failsafe", "crashed", "warned", "gps_lost",
    "inside_fence", "fault", "detected",
)  # fmt: skip
UNITS = {"m": "m", "mps": "m/s", "deg": "deg"}
# The attitude error of a named estimator, as the monitor scores it.
OF_ESTIMATOR = re.compile(r"\b([a-z]\w*)\.attitude_error_deg\b")
MODES = re.compile(r"\bmode\s*(==|!=|not\s+in\b|in\b)\s*(\[[^\]]*\]|[\w.\"']+)")
WORDS = re.compile(r"\b(" + "|".join(TRUTHS) + r")\b")
LENGTH_MAX = 1000  # longer than any formula by hand; bounds the parser's depth


class FlightSignals(NamedTuple):
    """Signals of a flight on one grid `t_s` (n,): `values` (n,) by name, NaN where unknown, and the
    name of the `modes` at each time. Requirements hold from `start_s` on, which is the end of the
    take-off; `fault_s` is the start of the first fault."""

    t_s: Vector
    values: Mapping[str, Vector]
    modes: Sequence[str]
    start_s: float
    fault_s: float | None = None


class RequirementResult(msgspec.Struct, frozen=True, kw_only=True):
    """How a flight meets a requirement: `robustness` is its distance to a violation, below zero
    after one (None if only true and false decide); `at_s` is the time of the violation, else of the
    smallest distance. `met` is None if the flight does not show it, for the `reason`."""

    name: str
    formula: str
    met: bool | None
    robustness: float | None = None
    unit: str = ""
    at_s: float | None = None
    reason: str = ""

    @property
    def fitness(self) -> float:
        """The robustness as a finite number; not shown counts as met by a distance of zero."""
        if self.robustness is None:
            return {True: LOGICAL, False: -LOGICAL, None: 0.0}[self.met]
        return self.robustness

    def describe(self) -> str:
        """Return the result in words."""
        if self.met is None:
            return f"not shown: {self.reason}"
        size = "" if self.robustness is None else f" by {abs(self.robustness):.3g} {self.unit}"
        when = "" if self.at_s is None else f" at {self.at_s:.2f} s"
        return f"{'satisfied' if self.met else 'violated'}{size.rstrip()}{when}"


class Requirement(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, dict=True):
    """A named formula. `since` is `start` or `fault`: a formula of `always` is judged from the end
    of the take-off on, any other at the first fault. An implication, and a formula without temporal
    operators, is meant always."""

    formula: str
    name: str = ""
    since: Literal["start", "fault"] | None = None
    source: str = ""

    def __post_init__(self) -> None:
        try:
            unknown = sorted(self.signals - {*NUMBERS, *TRUTHS} - set(self.modes))
        except ValueError as error:
            raise ValueError(f"formula {self.formula!r}: {error}") from None
        for name in unknown:
            if not name.endswith("__attitude_error_deg"):
                known = suggest_known(name, [*NUMBERS, *TRUTHS, "mode"])
                raise ValueError(f"formula {self.formula!r}: signal {name} is unknown; {known}")

    @property
    def label(self) -> str:
        """Its name in results: the formula if it has none."""
        return self.name or self.formula

    @cached_property
    def modes(self) -> dict[str, tuple[bool, frozenset[str]]]:
        """For each comparison of the mode, by its name as a signal: whether the mode is wanted, and
        the modes."""
        return {f"mode_{i}": mode for i, mode in enumerate(map(_wanted_modes, self._mode_texts))}

    @cached_property
    def _mode_texts(self) -> list[tuple[str, str]]:
        return MODES.findall(self.formula)

    @cached_property
    def tree(self) -> dict[str, Any]:
        """The parsed formula, in sentil's JSON form.

        Raises
        ------
        ValueError
            If the text is not a formula.
        """
        import sentil

        if len(self.formula) > LENGTH_MAX:
            raise ValueError(f"is longer than {LENGTH_MAX} characters; shorten it")
        names = iter(self.modes)
        text = MODES.sub(lambda _: f"({next(names)} > 0)", self.formula)
        text = OF_ESTIMATOR.sub(r"\1__attitude_error_deg", text)
        text = WORDS.sub(r"(\1 > 0)", text)
        try:
            formula = sentil.Formula.parse(text)
        except sentil.SentilError as error:
            raise ValueError(
                f"{error}; write for example: always(height_m > 5 or landing)"
            ) from None
        # An implication and a formula without temporal operators are meant for the entire flight.
        tree: dict[str, Any] = json.loads(formula.to_json())
        plain = "Implies" in tree or not formula.is_temporal
        return {"Always": [{"lower": 0.0, "upper": None}, tree]} if plain else tree

    @cached_property
    def signals(self) -> frozenset[str]:
        """The names of the signals that the formula uses."""
        return frozenset(_formula(self.tree).variables)

    @property
    def unit(self) -> str:
        """The unit of its robustness, if all its signals have the same."""
        units = {UNITS.get(name.rpartition("_")[2], "") for name in self.signals} - {""}
        return units.pop() if len(units) == 1 else ""

    @property
    def always(self) -> dict[str, Any] | None:
        """The formula inside an outermost `always` without bounds; None without one."""
        bounds, inner = self.tree.get("Always", ({"lower": 1.0}, None))
        found: dict[str, Any] | None = inner
        return found if bounds == {"lower": 0.0, "upper": None} else None

    def judge(self, flight: FlightSignals) -> RequirementResult:
        """Evaluate the formula on a flight."""
        import sentil

        inner, since = self.always, self.since
        since = since or ("fault" if inner is None else "start")
        start_s = flight.start_s if since == "start" else flight.fault_s
        if start_s is None or not np.isfinite(start_s):
            reason = "the vehicle never took off" if start_s else "no fault acted"
            return self._result(None, reason=reason)
        try:
            t_s, values = self._select(flight, start_s)
        except ValueError as error:
            return self._result(None, reason=str(error))
        trace = sentil.Trace(t_s, values)
        margins = _formula(inner or self.tree).robustness_signal(trace)
        margins = margins[:1] if inner is None else margins
        # A deadline after the end of the log is decided only if what it waits for came before.
        margins = margins[(t_s[: len(margins)] <= t_s[-1] - _deadline_s(self.tree)) | (margins > 0)]
        if not len(margins):
            return self._result(None, reason="the flight ended before the deadline")
        violated = np.flatnonzero(margins < 0.0)
        at = violated[0] if len(violated) else np.argmin(margins)
        return self._result(float(margins.min()), float(t_s[at]))

    def _select(self, flight: FlightSignals, start_s: float) -> tuple[Vector, dict[str, object]]:
        """Times and signals (n,) from `start_s` on, as far as all signals are known."""
        values: dict[str, Vector] = {}
        inside = flight.t_s >= start_s
        for name in self.signals:
            if name in self.modes:
                wanted, modes = self.modes[name]
                hit = np.array([mode in modes for mode in flight.modes]) == wanted
                values[name] = np.where(hit, TRUE, -TRUE)
                continue
            if name not in flight.values or np.isnan(flight.values[name]).all():
                shown = name.replace("__", ".")
                raise ValueError(f"the flight has no {shown}")
            values[name] = flight.values[name]
            inside &= np.isfinite(flight.values[name])
        if inside.sum() < 2:
            raise ValueError("its signals are not known at the same time")
        return flight.t_s[inside], {name: value[inside] for name, value in values.items()}

    def _result(
        self, robustness: float | None, at_s: float | None = None, reason: str = ""
    ) -> RequirementResult:
        met = None if robustness is None else robustness >= 0.0
        # One that comes from true and false alone is no distance.
        shown = robustness if met is None or abs(robustness or 0.0) < LOGICAL else None
        return RequirementResult(
            name=self.label, formula=self.formula, met=met, robustness=shown,
            unit=self.unit,
            at_s=None if at_s is None or (met and shown is None) else round(at_s, 3),
            reason=reason,
        )  # fmt: skip


def _wanted_modes(text: tuple[str, str]) -> tuple[bool, frozenset[str]]:
    comparison, names = text
    # PX4's own names have their main mode in front: AUTO.RTL.
    found = (name.strip(" \"'").removeprefix("AUTO.") for name in names.strip("[]").split(","))
    return comparison in ("==", "in"), frozenset(found)


def _formula(tree: dict[str, Any]) -> Any:
    import sentil

    return sentil.Formula.from_json(json.dumps(tree))


def _deadline_s(node: Any) -> float:
    """The longest time after which an `eventually` or `until` inside a formula is decided."""
    if not isinstance(node, (dict, list)):
        return 0.0
    parts = node.values() if isinstance(node, dict) else node
    later_s = max((_deadline_s(part) for part in parts), default=0.0)
    if not isinstance(node, dict):
        return later_s
    operator = next(iter(node), "")
    bounds = node[operator][0] if operator in ("Eventually", "Until", "Always") else {}
    # A bounded `always` is violated at once, unless it waits for something inside.
    waits = later_s > 0.0 or operator != "Always"
    return later_s + (bounds.get("upper") or 0.0 if waits else 0.0)


def ready_requirements() -> dict[str, Requirement]:
    """Return the requirements of the library by name."""
    text = (files("analysis.scoring") / "ready_requirements.yaml").read_text("utf-8")
    library: Any = read_yaml(text, "ready_requirements.yaml").data
    return {name: Requirement(name=name, **keys) for name, keys in library.items()}


def parse_requirements(section: Any) -> tuple[Requirement, ...]:
    """Read requirements: a list of formulas, names of the library and mappings with the keys of
    `Requirement`, or a mapping of names to formulas.

    Raises
    ------
    ValueError
        If a formula or name is wrong.
    """
    items = section or []
    if isinstance(section, Mapping):
        items = [
            {"name": name, **(item if isinstance(item, Mapping) else {"formula": item})}
            for name, item in section.items()
        ]
    if isinstance(items, str):
        items = [items]
    found = tuple(_parse_requirement(item) for item in items)
    names = [one.label for one in found]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"{name} occurs twice; give each another name")
    return found


def requirement_arguments(requirements: Iterable[Requirement]) -> list[str]:
    """Return the arguments of `run` for requirements."""
    texts = (json.dumps(msgspec.to_builtins(one)) for one in requirements)
    return [word for text in texts for word in ("--require", text)]


def read_requirements(where: str, section: Any) -> tuple[Requirement, ...]:
    """Read requirements as `parse_requirements` does.

    Raises
    ------
    ConfigError
        If a formula or name is wrong.
    """
    try:
        return parse_requirements(section)
    except ValueError as error:
        raise ConfigError(f"{where}: {error}") from None


def _parse_requirement(item: Any) -> Requirement:
    if isinstance(item, Mapping):
        try:
            return msgspec.convert(dict(item), Requirement)
        except msgspec.ValidationError as error:
            raise ValueError(str(error)) from None
    text = str(item)
    # The keys of `Requirement` in one line, as `requirement_arguments` writes them.
    if text.startswith("{"):
        return _parse_requirement(read_yaml(text, "--require").data)
    ready = ready_requirements()
    if re.fullmatch(r"[a-z_]+", text) and text not in TRUTHS:
        if text not in ready:
            raise ValueError(f"{text} is unknown; {suggest_known(text, list(ready))}")
        return ready[text]
    return Requirement(formula=text)

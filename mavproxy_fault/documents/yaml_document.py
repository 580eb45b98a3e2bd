"""Reads YAML text to data with the line of every key and item, and writes data as YAML.

The data follow YAML 1.2's core schema [1]_: `1e-4` is a number, `1:30`, `yes` and a date are text.
Mistakes are refused with their line: a duplicate key, a tag, a key that is not a scalar, a number
that parsers read differently (`010`) or that exceeds 64 bits. Limits on size, depth and expanded
aliases keep a hostile text from exhausting stack, memory or time.

.. [1] YAML Ain't Markup Language, version 1.2.2, section 10.3.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path as FilePath
from typing import Any, NamedTuple, NoReturn

import yaml

from mavproxy_fault.documents.errors import ConfigError

Path = tuple[str | int, ...]
Lines = dict[Path, int]

# Chosen: far above files written by hand, which have kilobytes.
MOST_BYTES = 8 << 20
MOST_NODES = 400_000  # scalars, lists and mappings, with the expanded aliases
DEEPEST = 40
TOO_DEEP = f"is nested deeper than {DEEPEST} lists or mappings"
MOST_DIGITS = 400  # of a number; far beyond the precision of 64 bits, and fast to convert

INTEGER = re.compile(r"[-+]?[0-9]+")
AMBIGUOUS = re.compile(r"[-+]?0[0-9]+")  # octal for YAML 1.1, decimal for 1.2
BASED = re.compile(r"0o[0-7]+|0x[0-9a-fA-F]+")
FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
BRACKETED = re.compile(r"\{.*\w\[\d")  # `{target: controls[1]}`, where `[` begins a list
NAMED_SCALARS = {
    "": None, "~": None, "null": None, "Null": None, "NULL": None,
    "true": True, "True": True, "TRUE": True, "false": False, "False": False, "FALSE": False,
}  # fmt: skip
NOT_FINITE = re.compile(r"([-+]?)\.(inf|Inf|INF)|\.(nan|NaN|NAN)")


class Flaw(NamedTuple):
    """A refused value or key in a text that is readable otherwise."""

    path: Path
    line: int
    text: str


class Document(NamedTuple):
    """The data of a YAML text, its name in errors, and the first line of each part."""

    data: Any
    where: str
    lines: Lines


class FlawedDocumentError(ConfigError):
    """Carries the flaws of a document, for callers that add errors of their own."""

    def __init__(self, document: Document, flaws: Sequence[Flaw]) -> None:
        super().__init__("\n".join(flaw.text for flaw in flaws[:DEEPEST]))
        self.document, self.flaws = document, flaws


def read_document(path: FilePath | str) -> Document:
    """Read a YAML file in UTF-8.

    Raises
    ------
    ConfigError
        If the file cannot be read, or its text is refused by `read_yaml`.
    """
    try:
        with open(path, "rb") as file:
            # One byte more than allowed reveals a larger file without reading all of it.
            content = file.read(MOST_BYTES + 1)
        # `-sig`: editors on Windows write a byte-order mark.
        text = content.decode("utf-8-sig")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror}); give a YAML file") from None
    except UnicodeDecodeError:
        raise ConfigError(f"{path}: is not UTF-8 text; give a YAML file in UTF-8") from None
    except ValueError:  # a NUL in the name
        raise ConfigError(f"{str(path)!r}: is not a file name; give a YAML file") from None
    return read_yaml(text, str(path))


def read_yaml(text: str, where: str) -> Document:
    """Read a YAML text; `where` names it in errors.

    Raises
    ------
    ConfigError
        If the text is not YAML or exceeds the limits.
    FlawedDocumentError
        If it contains refused values: all of them at once.
    """
    if len(text) > MOST_BYTES:
        raise ConfigError(f"{where}: is too large; at most {MOST_BYTES >> 20} MB are read")
    builder = _Builder(where, yaml.parse(text, yaml.CSafeLoader))
    try:
        data = builder.build()
    except yaml.YAMLError as error:
        # Some parser errors have no mark, for example for invalid characters.
        mark = getattr(error, "problem_mark", None)
        line = f":{mark.line + 1}" if mark is not None else ""
        problem = getattr(error, "problem", None) or getattr(error, "reason", "is corrupted")
        if "nesting depth" in str(problem):  # libyaml's limit is lower than ours
            raise ConfigError(f"{where}{line}: {TOO_DEEP}") from None
        advice = "see yaml.org"
        faulty = "".join(text.splitlines()[mark.line :][:1]) if mark is not None else ""
        if BRACKETED.search(faulty):
            advice = 'between braces, quote a name with brackets: "controls[1]"'
        raise ConfigError(f"{where}{line}: not YAML: {problem}; {advice}") from None
    except UnicodeEncodeError:  # half a surrogate pair, which UTF-8 cannot encode
        raise ConfigError(f"{where}: is not UTF-8 text; give YAML in UTF-8") from None
    document = Document(data, where, builder.lines)
    if builder.flaws:
        raise FlawedDocumentError(document, builder.flaws)
    return document


def write_yaml(data: Any, *, flow: bool | None = False, width: int = 80) -> str:
    """Format data as YAML for `read_yaml`; `flow` None puts innermost values on one line."""
    return yaml.dump(data, Dumper=_Dumper, sort_keys=False, default_flow_style=flow, width=width)


def without_none(node: Any) -> Any:
    """Return a copy of a document without entries that are None."""
    if isinstance(node, Mapping):
        return {key: without_none(value) for key, value in node.items() if value is not None}
    return [without_none(item) for item in node] if isinstance(node, (list, tuple)) else node


def parse_scalar(text: str) -> Any:
    """Return the value of an unquoted scalar.

    Raises
    ------
    ValueError
        If YAML parsers read it differently, or it exceeds 64 bits.
    """
    if text in NAMED_SCALARS:
        return NAMED_SCALARS[text]
    # Before `float`, whose time grows with the square of the digits.
    if len(text) > MOST_DIGITS and FLOAT.fullmatch(text):
        raise ValueError(f"has {len(text)} digits; at most {MOST_DIGITS} are read")
    if AMBIGUOUS.fullmatch(text):
        raise ValueError(f"= {text} may be octal; write {int(text)}, or quote it if it is text")
    if INTEGER.fullmatch(text) or BASED.fullmatch(text):
        number = int(text, 10 if INTEGER.fullmatch(text) else 0)
        # From the lowest signed to the highest unsigned 64-bit integer.
        if not -(1 << 63) <= number < 1 << 64:
            raise ValueError(f"= {text} is out of range; integers have at most 64 bits")
        return number
    if FLOAT.fullmatch(text):
        value = float(text)
        # `1e999` would silently become infinite.
        if abs(value) == float("inf"):
            raise ValueError(f"= {text} is out of range; numbers reach 1.8e308")
        return value
    if found := NOT_FINITE.fullmatch(text):
        return float(found[1] + "inf") if found[2] else float("nan")
    return text


class _Builder:
    """Builds data from the parser's events, and counts the values."""

    def __init__(self, where: str, events: Iterator[Any]) -> None:
        self.where = where
        self.lines: Lines = {}
        self.flaws: list[Flaw] = []
        self._events = events
        self._anchors: dict[str, tuple[Any, int]] = {}
        self._nodes = 0

    def build(self) -> Any:
        """Return the data of the text; None if it is empty."""
        data, documents = None, 0
        for event in self._events:
            if isinstance(event, yaml.NodeEvent):
                data = self._value(event, ())
            elif isinstance(event, yaml.DocumentStartEvent):
                documents += 1
                if documents > 1:
                    self._refuse(event, "begins a second document; only one is allowed")
        return data

    def _value(self, event: Any, path: Path) -> Any:
        """Return the value that begins with an event."""
        self._count(event)
        # The values of keys already have a line; items and the root get theirs here.
        self.lines.setdefault(path, self._line(event))
        if isinstance(event, yaml.AliasEvent):
            if event.anchor not in self._anchors:
                self._refuse(event, f"*{event.anchor} contains itself or is not defined above")
            value, size = self._anchors[event.anchor]
            # An alias counts as its expansion, since few bytes can expand to billions.
            self._nodes += size
            return value
        self._refuse_tag(event)
        # An anchor is undefined within itself: a value cannot contain itself.
        self._anchors.pop(event.anchor, None)
        before = self._nodes
        if isinstance(event, yaml.ScalarEvent):
            value = self._scalar(event, path)
        elif len(path) == DEEPEST:
            self._refuse(event, TOO_DEEP)
        elif isinstance(event, yaml.SequenceStartEvent):
            value = []
            while not isinstance(item := next(self._events), yaml.SequenceEndEvent):
                value.append(self._value(item, (*path, len(value))))
        else:
            value = {}
            while not isinstance(key := next(self._events), yaml.MappingEndEvent):
                self._key(key, path, value)
                value[key.value] = self._value(next(self._events), (*path, key.value))
        if event.anchor is not None:
            self._anchors[event.anchor] = value, self._nodes - before
        return value

    def _count(self, event: Any) -> None:
        self._nodes += 1
        if self._nodes > MOST_NODES:
            self._refuse(event, f"has more than {MOST_NODES} values; split the file")

    def _key(self, event: Any, path: Path, items: dict[str, Any]) -> None:
        self._count(event)
        if not isinstance(event, yaml.ScalarEvent):
            self._refuse(event, "has a list or mapping as a key; use a plain key")
        self._refuse_tag(event)
        here = (*path, event.value)
        if event.value in items:
            self._add_flaw(event, here, f"{event.value} is given twice; give each key once")
        self.lines[here] = self._line(event)

    def _scalar(self, event: Any, path: Path) -> Any:
        # A quoted or block scalar is always text.
        if not event.style:
            try:
                return parse_scalar(event.value)
            except ValueError as error:
                self._add_flaw(event, path, f"{format_path(path)} {error}".lstrip())
        return event.value

    def _refuse_tag(self, event: Any) -> None:
        if event.tag is not None:
            self._refuse(event, f"has the tag {event.tag}; give a plain value")

    @staticmethod
    def _line(event: Any) -> int:
        line: int = event.start_mark.line + 1
        return line

    def _add_flaw(self, event: Any, path: Path, text: str) -> None:
        """Add a flaw and continue, so that one run reports all flaws."""
        line = self._line(event)
        self.flaws.append(Flaw(path, line, f"{self.where}:{line}: {text}"))

    def _refuse(self, event: Any, text: str) -> NoReturn:
        raise ConfigError(f"{self.where}:{self._line(event)}: {text}")


def format_path(path: Path) -> str:
    """Format a path as faults[3].profile.segments[0].rate."""
    text = ""
    for part in path:
        # The first part has no dot.
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return text


class _Dumper(yaml.SafeDumper):
    """Quotes text that is a number in YAML 1.2 but not in PyYAML, which follows 1.1."""


# PyYAML selects a resolver by the first character.
_Dumper.add_implicit_resolver("tag:yaml.org,2002:float", FLOAT, list("-+.0123456789"))
_Dumper.add_implicit_resolver("tag:yaml.org,2002:int", BASED, ["0"])

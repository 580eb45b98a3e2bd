"""YAML text to data, with the line of every key and item; and back.

The data follow YAML 1.2's core schema [1]_: `1e-4` is a number, `1:30`, `yes` and a date are text.
What cannot be meant in a configuration is refused with its line: a doubled key, a tag, a key that
is no word, a number that depends on the reader (`010`) or fits no 64 bits. Limits on size, depth
and expanded aliases keep a hostile text from exhausting stack, memory or time.

.. [1] YAML Ain't Markup Language, version 1.2.2, section 10.3.
"""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path as FilePath
from typing import Any, NamedTuple, NoReturn

import yaml

from mavproxy_fault.documents.errors import ConfigError

Path = tuple[str | int, ...]
Lines = dict[Path, int]

# Schedules of people are kilobytes; the limits keep out what was not written by hand.
MOST_BYTES = 8 << 20
MOST_NODES = 400_000  # scalars, lists and mappings, aliases counted with all they stand for
DEEPEST = 40
TOO_DEEP = f"is nested deeper than {DEEPEST} lists or mappings"
MOST_DIGITS = 400  # of a number; beyond, converting it takes time and says nothing

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
    """A value or key that is refused although the rest of a text can be read."""

    path: Path
    line: int
    text: str


class Document(NamedTuple):
    """The data of a YAML text, its name in errors, and the line on which each part begins."""

    data: Any
    where: str
    lines: Lines


class FlawedDocumentError(ConfigError):
    """The flaws of a document, for those who have more to say of it."""

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
            # One byte more than allowed tells a larger file without reading it whole.
            content = file.read(MOST_BYTES + 1)
        # `-sig`: editors on Windows put a byte-order mark first.
        text = content.decode("utf-8-sig")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror}); give a YAML file") from None
    except UnicodeDecodeError:
        raise ConfigError(f"{path}: is not text; a YAML file in UTF-8 is expected") from None
    except ValueError:  # a NUL in the name
        raise ConfigError(f"{str(path)!r}: is no file's name; give a YAML file") from None
    return read_yaml(text, str(path))


def read_yaml(text: str, where: str) -> Document:
    """Read a YAML text; `where` names it in errors.

    Raises
    ------
    ConfigError
        If the text is no YAML or is beyond the limits.
    FlawedDocumentError
        If it holds values that are refused: all of them at once, as all other errors.
    """
    if len(text) > MOST_BYTES:
        raise ConfigError(f"{where}: is too large; at most {MOST_BYTES >> 20} MB are read")
    builder = _Builder(where)
    try:
        builder.build(yaml.parse(text, yaml.CSafeLoader))
    except yaml.YAMLError as error:
        # Some errors of the parser carry no mark, for example of bytes that are no characters.
        mark = getattr(error, "problem_mark", None)
        line = f":{mark.line + 1}" if mark is not None else ""
        problem = getattr(error, "problem", None) or getattr(error, "reason", "is damaged")
        if "nesting depth" in str(problem):  # libyaml's own limit, met before ours is
            raise ConfigError(f"{where}{line}: {TOO_DEEP}") from None
        advice = "see yaml.org"
        told = "".join(text.splitlines()[mark.line :][:1]) if mark is not None else ""
        if BRACKETED.search(told):
            advice = 'between braces a name with brackets is quoted: "controls[1]"'
        raise ConfigError(f"{where}{line}: not YAML: {problem}; {advice}") from None
    except UnicodeEncodeError:  # half a surrogate pair, which no file in UTF-8 holds
        raise ConfigError(f"{where}: is not text; YAML in UTF-8 is expected") from None
    document = Document(builder.data, where, builder.lines)
    if builder.flaws:
        raise FlawedDocumentError(document, builder.flaws)
    return document


def write_yaml(data: Any, *, flow: bool | None = False, width: int = 80) -> str:
    """Data as YAML that `read_yaml` reads back; `flow` None puts the innermost on one line."""
    return yaml.dump(data, Dumper=_Dumper, sort_keys=False, default_flow_style=flow, width=width)


def parse_scalar(text: str) -> Any:
    """What an unquoted scalar means.

    Raises
    ------
    ValueError
        If readers of YAML do not agree on it, or it fits no 64 bits.
    """
    if text in NAMED_SCALARS:
        return NAMED_SCALARS[text]
    # Before `float`: the time to convert grows with the square of the digits.
    if len(text) > MOST_DIGITS and FLOAT.fullmatch(text):
        raise ValueError(f"has {len(text)} digits; at most {MOST_DIGITS} are read")
    if AMBIGUOUS.fullmatch(text):
        raise ValueError(f"= {text} is octal to some; write {int(text)}, or quote it if it is text")
    if INTEGER.fullmatch(text) or BASED.fullmatch(text):
        number = int(text, 10 if INTEGER.fullmatch(text) else 0)
        # From the lowest signed to the highest unsigned number of 64 bits.
        if not -(1 << 63) <= number < 1 << 64:
            raise ValueError(f"= {text} does not fit; whole numbers have 64 bits")
        return number
    if FLOAT.fullmatch(text):
        value = float(text)
        # `1e999` would silently become infinite.
        if abs(value) == float("inf"):
            raise ValueError(f"= {text} does not fit; numbers reach 1.8e308")
        return value
    if found := NOT_FINITE.fullmatch(text):
        return float(found[1] + "inf") if found[2] else float("nan")
    return text


@dataclass(slots=True)
class _Open:
    """A list or mapping whose end has not come yet; `key` waits for its value."""

    path: Path
    items: Any
    anchor: str | None
    began: int
    key: str | None = None


class _Builder:
    """Builds data from the parser's events without recursion, and counts what it builds."""

    def __init__(self, where: str) -> None:
        self.where = where
        self.data: Any = None
        self.lines: Lines = {}
        self.flaws: list[Flaw] = []
        self._open: list[_Open] = []
        self._anchors: dict[str, tuple[Any, int]] = {}
        self._nodes = 0
        self._documents = 0

    def build(self, events: Iterable[Any]) -> None:
        """Take in all events of a text."""
        for event in events:
            if isinstance(event, yaml.NodeEvent):
                self._node(event)
            elif isinstance(event, yaml.SequenceEndEvent | yaml.MappingEndEvent):
                done = self._open.pop()
                self._remember(done.anchor, done.items, self._nodes - done.began)
            elif isinstance(event, yaml.DocumentStartEvent):
                self._documents += 1
                if self._documents > 1:
                    self._refuse(event, "begins a second document; one is read")

    def _node(self, event: Any) -> None:
        self._nodes += 1
        if self._nodes > MOST_NODES:
            self._refuse(event, f"goes beyond {MOST_NODES} values; split the file")
        parent = self._open[-1] if self._open else None
        # In a mapping keys and values come in turn.
        if parent is not None and isinstance(parent.items, dict) and parent.key is None:
            self._key(event, parent)
            return
        path = _path_below(parent)
        # The line of a key is known already; items and the root get their own here.
        self.lines.setdefault(path, self._line(event))
        value = self._value(event, path)
        if parent is None:
            self.data = value
        elif isinstance(parent.items, list):
            parent.items.append(value)
        else:
            parent.items[parent.key] = value
            parent.key = None

    def _key(self, event: Any, parent: _Open) -> None:
        if not isinstance(event, yaml.ScalarEvent):
            self._refuse(event, "has a list or mapping as a key; keys are words")
        self._untagged(event)
        line = self._line(event)
        if event.value in parent.items:
            path = (*parent.path, event.value)
            self._note(event, path, f"{event.value} stands twice; give each key once")
        parent.key = event.value
        self.lines[(*parent.path, event.value)] = line

    def _value(self, event: Any, path: Path) -> Any:
        if isinstance(event, yaml.AliasEvent):
            if event.anchor not in self._anchors:
                self._refuse(event, f"*{event.anchor} holds itself or is not defined above")
            value, size = self._anchors[event.anchor]
            # An alias counts as much as it stands for: few bytes can expand to billions.
            self._nodes += size
            return value
        self._untagged(event)
        if isinstance(event, yaml.ScalarEvent):
            value = event.value
            # A quoted or block scalar is text whatever it looks like.
            if not event.style:
                try:
                    value = parse_scalar(event.value)
                except ValueError as error:
                    self._note(event, path, f"{format_path(path)} {error}".lstrip())
            self._remember(event.anchor, value, 1)
            return value
        if len(self._open) == DEEPEST:
            self._refuse(event, TOO_DEEP)
        items: Any = [] if isinstance(event, yaml.SequenceStartEvent) else {}
        # Within itself an anchor is not defined: a value cannot hold itself.
        self._anchors.pop(event.anchor, None)
        self._open.append(_Open(path, items, event.anchor, self._nodes))
        return items

    def _remember(self, anchor: str | None, value: Any, size: int) -> None:
        if anchor is not None:
            self._anchors[anchor] = value, size

    def _untagged(self, event: Any) -> None:
        if event.tag is not None:
            self._refuse(event, f"has the tag {event.tag}; plain values are read only")

    @staticmethod
    def _line(event: Any) -> int:
        line: int = event.start_mark.line + 1
        return line

    def _note(self, event: Any, path: Path, text: str) -> None:
        """What is wrong, but does not end the reading: one run shows every such flaw."""
        line = self._line(event)
        self.flaws.append(Flaw(path, line, f"{self.where}:{line}: {text}"))

    def _refuse(self, event: Any, text: str) -> NoReturn:
        raise ConfigError(f"{self.where}:{self._line(event)}: {text}")


def _path_below(parent: _Open | None) -> Path:
    """The path of the value that comes next in a list or mapping."""
    if parent is None:
        return ()
    if isinstance(parent.items, list):
        return (*parent.path, len(parent.items))
    assert parent.key is not None
    return (*parent.path, parent.key)


def format_path(path: Path) -> str:
    """A path as a person writes it: faults[3].profile.segments[0].rate."""
    text = ""
    for part in path:
        # The first part stands without a dot.
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return text


class _Dumper(yaml.SafeDumper):
    """Quotes what YAML 1.2 takes for a number and PyYAML, which follows 1.1, does not."""


# The first characters by which PyYAML finds the resolver.
_Dumper.add_implicit_resolver("tag:yaml.org,2002:float", FLOAT, list("-+.0123456789"))
_Dumper.add_implicit_resolver("tag:yaml.org,2002:int", BASED, ["0"])

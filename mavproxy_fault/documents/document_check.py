"""Data of a document turned into msgspec structs, with all errors of a file, not the first."""

import math
import re
import reprlib
import types
import typing
from collections.abc import Iterable, Sequence
from typing import Annotated, Any, Literal, TypeVar

import msgspec
from msgspec import Meta

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.suggestion import suggest_known
from mavproxy_fault.documents.yaml_document import Document, Flaw, Lines, Path, format_path

T = TypeVar("T")

NotFinite = Annotated[float, Meta(extra={"finite": False})]
"""A number that may be `.inf` or `.nan`; everywhere else these are refused."""

# Enough to work on; a file of another kind would give thousands.
MOST_ERRORS = 30
# Texts of our own structs begin with the field they mean: `segments[1].at_s = ...`.
MENTIONED = re.compile(r"([A-Za-z_]\w*)((?:\.\w+|\[\d+\])*) ")
UNIONS = (typing.Union, types.UnionType)


def decode(document: Document, kind: type[T], at: Path = ()) -> T:
    """The part of a document at a path, as `kind`.

    Raises
    ------
    ConfigError
        With every key and value that is wrong, each with its line and what is allowed.
    """
    data = document.data
    for key in at:
        data = data[key]
    check = DocumentCheck(document.where, document.lines)
    found: T = check.value(data, kind, at)
    check.finish()
    return found


class DocumentCheck:
    """Gathers every error of one file while its parts are converted."""

    def __init__(self, where: str, lines: Lines | None = None, flaws: Sequence[Flaw] = ()) -> None:
        self.where = where
        self.lines = lines or {}
        self.count = 0  # of all errors, those of flawed values too that are not told twice
        self._errors: list[tuple[int, str]] = [(flaw.line, flaw.text) for flaw in flaws]
        self._flawed = {flaw.path for flaw in flaws}

    def wrong(self, path: Path, text: str) -> None:
        """Note an error at the nearest line known, unless a value there was refused already."""
        self.count += 1
        if any(flawed[: len(path)] == path for flawed in self._flawed):
            return
        # The nearest ancestor with a line: a missing key has none of its own.
        line = next((self.lines[path[:n]] for n in range(len(path), -1, -1)
                     if path[:n] in self.lines), 0)  # fmt: skip
        place = f"{self.where}:{line}" if line else self.where
        self._errors.append((line, f"{place}: {format_path(path)}{' ' if path else ''}{text}"))

    def finish(self) -> None:
        """Raise all errors, in the order of their lines.

        Raises
        ------
        ConfigError
            If there are any.
        """
        if self._errors:
            # By line, since parts of a file are checked in another order than they stand in.
            in_order = [text for _, text in sorted(self._errors, key=lambda error: error[0])]
            more = len(in_order) - MOST_ERRORS
            last = [f"{self.where}: {more} more errors"] if more > 0 else []
            raise ConfigError("\n".join(in_order[:MOST_ERRORS] + last))

    def keys(self, data: dict[Any, Any], known: Iterable[str], path: Path) -> None:
        """Note every key that is not known."""
        names = list(known)
        for key in data:
            if key not in names:
                self.wrong((*path, str(key)), f"is unknown; {suggest_known(str(key), names)}")

    def value(self, data: Any, kind: Any, path: Path) -> Any:
        """One value converted to a type; None with the errors noted if it does not fit."""
        # The first member of a union that fits by its form; scalars are left to msgspec.
        for choice in _choices(kind):
            origin, inner = typing.get_origin(choice), typing.get_args(choice)
            if isinstance(data, dict):
                if isinstance(choice, type) and issubclass(choice, msgspec.Struct):
                    return self.struct(data, choice, path)
                if origin is dict and inner[0] is str:
                    return {k: self.value(v, inner[1], (*path, str(k))) for k, v in data.items()}
            if isinstance(data, list) and origin in (list, tuple):
                # A fixed tuple has a type per place, all others one type for each item.
                each = inner if origin is tuple and inner[1:] != (...,) else inner[:1] * len(data)
                if len(each) == len(data):
                    parts = zip(data, each, strict=True)
                    return origin(self.value(d, k, (*path, i)) for i, (d, k) in enumerate(parts))
        return self._scalar(data, kind, path)

    def _scalar(self, data: Any, kind: Any, path: Path) -> Any:
        # YAML's `.inf` and `.nan` are floats: msgspec would let them pass.
        if isinstance(data, float) and not math.isfinite(data) and not _may_be_infinite(kind):
            self.wrong(path, f"= {data} is not finite; a number is needed")
            return None
        try:
            return msgspec.convert(data, kind)
        except msgspec.ValidationError as error:
            self.wrong(path, f"= {reprlib.repr(data)} {_misfit(data, kind, str(error))}")
            return None

    def arguments(
        self, data: dict[str, Any], kind: type[msgspec.Struct], path: Path, given: Iterable[str]
    ) -> dict[str, Any]:
        """The struct's fields found in `data`, converted; those `given` are left to the caller."""
        hints = typing.get_type_hints(kind, include_extras=True)
        found: dict[str, Any] = {}
        for field in msgspec.structs.fields(kind):
            if field.name in given:
                continue
            # A key that is a word of Python is a field by another name.
            key = field.encode_name
            if key in data:
                found[field.name] = self.value(data[key], hints[field.name], (*path, key))
            elif field.required:
                self.wrong(path, f"lacks {key}; it must be given")
        return found

    def struct(self, data: Any, kind: type[msgspec.Struct], path: Path) -> Any:
        """A whole struct; None with the errors noted if it is wrong."""
        if not isinstance(data, dict):
            self.wrong(path, f"= {reprlib.repr(data)} does not fit: expected keys and values")
            return None
        # Errors of the fields come first: a half-filled struct would add wrong ones.
        before = self.count
        self.keys(data, (field.name for field in msgspec.structs.fields(kind)), path)
        found = self.arguments(data, kind, path, ())
        if self.count > before:
            return None
        try:
            return kind(**found)
        except ValueError as error:
            self.refused(kind, str(error), path)
            return None

    def refused(self, kind: type[msgspec.Struct], text: str, path: Path) -> None:
        """Note what a struct says of its own fields, at the line of the one it names first."""
        named = MENTIONED.match(text)
        if named is not None and named[1] in (f.name for f in msgspec.structs.fields(kind)):
            parts = re.findall(r"\.(\w+)|\[(\d+)\]", named[2])
            # The path is made longer by what the text names, so that the line is the very item's.
            path = (*path, named[1], *(name or int(index) for name, index in parts))
            text = text[named.end() :]
        self.wrong(path, text)


def _choices(kind: Any) -> tuple[Any, ...]:
    """The members of a union, without what is only annotated to them."""
    if typing.get_origin(kind) is Annotated:
        return _choices(typing.get_args(kind)[0])
    if typing.get_origin(kind) in UNIONS:
        return tuple(inner for choice in typing.get_args(kind) for inner in _choices(choice))
    return (kind,)


def _may_be_infinite(kind: Any) -> bool:
    """Whether a type, or a member of a union, is `NotFinite`."""
    if typing.get_origin(kind) in UNIONS:
        return any(_may_be_infinite(choice) for choice in typing.get_args(kind))
    notes = getattr(kind, "__metadata__", ())
    return any(isinstance(note, Meta) and note.extra == {"finite": False} for note in notes)


def _misfit(data: Any, kind: Any, error: str) -> str:
    """Why a value does not fit, and what would."""
    words = [word for choice in _choices(kind) if typing.get_origin(choice) is Literal
             for word in typing.get_args(choice)]  # fmt: skip
    # A fixed set of words: the likely one is suggested.
    if words and isinstance(data, str):
        return f"is unknown; {suggest_known(data, words)}"
    # msgspec ends its text with the path, which is known here already.
    text = error.split(" - at `$")[0]
    return f"does not fit: {text[0].lower()}{text[1:]}"

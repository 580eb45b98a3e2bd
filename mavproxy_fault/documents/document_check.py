"""Converts the data of a document to msgspec structs and collects all errors of the file."""

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


class Section(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of the sections of a file: unknown keys are errors."""


NotFinite = Annotated[float, Meta(extra={"finite": False})]
"""A number that may be `.inf` or `.nan`, which any other number may not."""
Positive = Annotated[float, Meta(gt=0)]
NotNegative = Annotated[float, Meta(ge=0)]

# Chosen: enough to work on; a file of another kind gives thousands.
MOST_ERRORS = 30
# Error texts of our structs begin with the field at fault: `segments[1].at_s = ...`.
MENTIONED = re.compile(r"([A-Za-z_]\w*)((?:\.\w+|\[\d+\])*) ")
OUT_OF_RANGE = re.compile(r"Expected `(float|int)( \| null)?` [<>]")  # an error of msgspec
UNIONS = (typing.Union, types.UnionType)


def decode(document: Document, kind: type[T], at: Path = ()) -> T:
    """Convert the part of a document at a path to `kind`.

    Raises
    ------
    ConfigError
        If keys or values are wrong: all of them, each with its line and the allowed values.
    """
    data = document.data
    for key in at:
        data = data[key]
    check = DocumentCheck(document.where, document.lines)
    found: T = check.value(data, kind, at)
    check.finish()
    return found


class DocumentCheck:
    """Collects the errors of one file while its parts are converted."""

    def __init__(self, where: str, lines: Lines | None = None, flaws: Sequence[Flaw] = ()) -> None:
        self.where = where
        self.lines = lines or {}
        self.count = 0  # all errors, including repeated ones of flawed values
        self._errors: list[tuple[int, str]] = [(flaw.line, flaw.text) for flaw in flaws]
        self._flawed = {flaw.path for flaw in flaws}

    def wrong(self, path: Path, text: str) -> None:
        """Add an error at the nearest known line, unless a value there already has one."""
        self.count += 1
        if any(flawed[: len(path)] == path for flawed in self._flawed):
            return
        # A missing key has no line; that of its nearest ancestor is used.
        line = next((self.lines[path[:n]] for n in range(len(path), -1, -1)
                     if path[:n] in self.lines), 0)  # fmt: skip
        place = f"{self.where}:{line}" if line else self.where
        self._errors.append((line, f"{place}: {format_path(path)}{' ' if path else ''}{text}"))

    def finish(self) -> None:
        """Raise all errors in the order of their lines.

        Raises
        ------
        ConfigError
            If there are any.
        """
        if self._errors:
            # Sorted, since the parts of a file are checked in another order.
            in_order = [text for _, text in sorted(self._errors, key=lambda error: error[0])]
            more = len(in_order) - MOST_ERRORS
            last = [f"{self.where}: {more} more errors"] if more > 0 else []
            raise ConfigError("\n".join(in_order[:MOST_ERRORS] + last))

    def keys(self, data: dict[Any, Any], known: Iterable[str], path: Path) -> None:
        """Add an error for every unknown key."""
        names = list(known)
        for key in data:
            if key not in names:
                self.wrong((*path, str(key)), f"is unknown; {suggest_known(str(key), names)}")

    def value(self, data: Any, kind: Any, path: Path) -> Any:
        """Convert one value to a type; on errors, add them and return None."""
        # The first union member that matches a mapping or list; msgspec converts scalars.
        for choice in _choices(kind):
            origin, inner = typing.get_origin(choice), typing.get_args(choice)
            if isinstance(data, dict):
                if isinstance(choice, type) and issubclass(choice, msgspec.Struct):
                    return self.struct(data, choice, path)
                if origin is dict and inner[0] is str:
                    return {k: self.value(v, inner[1], (*path, str(k))) for k, v in data.items()}
            if isinstance(data, list) and origin in (list, tuple):
                # A fixed tuple has one type per item, all others the same type for every item.
                each = inner if origin is tuple and inner[1:] != (...,) else inner[:1] * len(data)
                if len(each) == len(data):
                    parts = zip(data, each, strict=True)
                    return origin(self.value(d, k, (*path, i)) for i, (d, k) in enumerate(parts))
        return self._scalar(data, kind, path)

    def _scalar(self, data: Any, kind: Any, path: Path) -> Any:
        # YAML's `.inf` and `.nan` are floats, which msgspec accepts.
        if isinstance(data, float) and not math.isfinite(data) and not _may_be_infinite(kind):
            self.wrong(path, f"= {data} is not finite; give a finite number")
            return None
        try:
            return msgspec.convert(data, kind)
        except msgspec.ValidationError as error:
            self.wrong(path, f"= {reprlib.repr(data)} {_misfit(data, kind, str(error))}")
            return None

    def arguments(
        self, data: dict[str, Any], kind: type[msgspec.Struct], path: Path, given: Iterable[str]
    ) -> dict[str, Any]:
        """A struct's fields that are in `data`, converted; the caller adds those `given`."""
        hints = typing.get_type_hints(kind, include_extras=True)
        found: dict[str, Any] = {}
        for field in msgspec.structs.fields(kind):
            if field.name in given:
                continue
            # A key that is a Python keyword has another field name.
            key = field.encode_name
            if key in data:
                found[field.name] = self.value(data[key], hints[field.name], (*path, key))
            elif field.required:
                self.wrong(path, f"lacks {key}, which is required; add it")
        return found

    def struct(self, data: Any, kind: type[msgspec.Struct], path: Path) -> Any:
        """Convert a mapping to a struct; on errors, add them and return None."""
        if not isinstance(data, dict):
            self.wrong(path, f"= {reprlib.repr(data)} does not fit: expected keys and values")
            return None
        # Stop after errors of fields, or the incomplete struct would add false ones.
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
        """Add an error raised by a struct, at the line of the field that its text begins with."""
        named = MENTIONED.match(text)
        if named is not None and named[1] in (f.name for f in msgspec.structs.fields(kind)):
            parts = re.findall(r"\.(\w+)|\[(\d+)\]", named[2])
            # The path is extended to the item named, for its exact line.
            path = (*path, named[1], *(name or int(index) for name, index in parts))
            text = text[named.end() :]
        self.wrong(path, text)


def _choices(kind: Any) -> tuple[Any, ...]:
    """Return the members of a union without annotations."""
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


def _range_text(kind: Any) -> str:
    """Return in words the numbers that a type, or a member of a union, allows."""
    if typing.get_origin(kind) in UNIONS:
        return next(filter(None, map(_range_text, typing.get_args(kind))), "")
    words = {"gt": "above {:g}", "ge": "{:g} or more", "lt": "below {:g}", "le": "at most {:g}"}
    notes = [note for note in getattr(kind, "__metadata__", ()) if isinstance(note, Meta)]
    limits = [(text, getattr(note, name)) for note in notes for name, text in words.items()]
    return ", ".join(text.format(limit) for text, limit in limits if limit is not None)


def _misfit(data: Any, kind: Any, error: str) -> str:
    """Return why a value does not fit, and which values do."""
    words = [word for choice in _choices(kind) if typing.get_origin(choice) is Literal
             for word in typing.get_args(choice)]  # fmt: skip
    # For a fixed set of values, suggest the likely one.
    if words and isinstance(data, str):
        return f"is unknown; {suggest_known(data, words)}"
    if OUT_OF_RANGE.match(error):
        return f"is out of range; {_range_text(kind)} is allowed"
    # msgspec appends the path, which is already in the error.
    text = error.split(" - at `$")[0]
    return f"does not fit: {text[0].lower()}{text[1:]}"

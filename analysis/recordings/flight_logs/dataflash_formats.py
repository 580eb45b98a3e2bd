"""Formats of a dataflash log's messages: its FMT messages, repaired where a byte is wrong.

An FMT has type, length, name, format characters and column names [1]_. It is stored once, so that
one wrong byte would cost all messages of its type. Most are redundant: the length follows from the
characters, the type from the messages that have no format, name and columns from those below.

.. [1] ArduPilot, libraries/AP_Logger/LogStructure.h.
"""

import re
import struct
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]
MAGIC = b"\xa3\x95"
HEAD = 3  # header bytes of a message
FORMATS = 0x80  # the type of FMT messages
FORMAT_BYTES = 89  # of an FMT
FIRST = MAGIC + bytes((FORMATS, FORMATS, FORMAT_BYTES)) + b"FMT"  # the FMT of FMT messages
# numpy type and factor of each format character.
TYPES: Mapping[str, tuple[str, float | None]] = {
    "a": ("S64", None), "b": ("<i1", None), "B": ("<u1", None), "h": ("<i2", None),
    "H": ("<u2", None), "i": ("<i4", None), "I": ("<u4", None), "f": ("<f4", None),
    "d": ("<f8", None), "g": ("<f2", None), "n": ("S4", None), "N": ("S16", None),
    "Z": ("S64", None), "c": ("<i2", 0.01), "C": ("<u2", 0.01), "e": ("<i4", 0.01),
    "E": ("<u4", 0.01), "L": ("<i4", 1e-7), "M": ("<i1", None), "q": ("<i8", None),
    "Q": ("<u8", None),
}  # fmt: skip
SIZES = {code: np.dtype(kind).itemsize for code, (kind, _) in TYPES.items()}
FEW_UNUSED = 3  # chosen: formats of unused types, up to which the length alone identifies one
# First columns of messages that reports and tests need, to recognise a damaged name.
KNOWN = {
    "PARM": ("TimeUS", "Name", "Value"), "MSG": ("TimeUS", "Message"), "EV": ("TimeUS", "Id"),
    "MODE": ("TimeUS", "Mode", "ModeNum"), "ERR": ("TimeUS", "Subsys", "ECode"),
    "ATT": ("TimeUS", "DesRoll", "Roll", "DesPitch", "Pitch", "DesYaw", "Yaw"),
    "IMU": ("TimeUS", "I", "GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ"),
    "GPS": ("TimeUS", "I", "Status", "GMS", "GWk", "NSats", "HDop", "Lat", "Lng", "Alt", "Spd"),
    "POS": ("TimeUS", "Lat", "Lng", "Alt", "RelHomeAlt"), "RCOU": ("TimeUS", "C1", "C2", "C3"),
    "VIBE": ("TimeUS", "IMU", "VibeX", "VibeY", "VibeZ", "Clip"), "RCIN": ("TimeUS", "C1", "C2"),
    "BAT": ("TimeUS", "Inst", "Volt", "VoltR", "Curr"), "BARO": ("TimeUS", "I", "Alt", "Press"),
    "MAG": ("TimeUS", "I", "MagX", "MagY", "MagZ"), "CTUN": ("TimeUS", "ThI", "ABst", "ThO"),
    "RATE": ("TimeUS", "RDes", "R", "ROut"), "XKF1": ("TimeUS", "C", "Roll", "Pitch", "Yaw"),
    "XKF4": ("TimeUS", "C", "SV", "SP", "SH", "SM"), "GPA": ("TimeUS", "I", "VDop", "HAcc"),
    "POWR": ("TimeUS", "Vcc", "VServo"), "ARM": ("TimeUS", "ArmState"),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class MessageFormat:
    """The format of one type of message.

    `codes` has a character per column, and "?" with its size (`sizes`) where it is unreadable.
    `sound` if all parts of the FMT agree.
    """

    type: int
    name: str
    columns: tuple[str, ...]
    codes: str
    sizes: tuple[int, ...]
    sound: bool

    @property
    def length(self) -> int:
        """Bytes of a message with its header."""
        return HEAD + sum(self.sizes)

    def dtype(self) -> np.dtype[np.void]:
        """The type of a row: the message's offset in the file, then its fields."""
        kinds = [
            TYPES[code][0] if code in TYPES else f"V{size}"
            for code, size in zip(self.codes, self.sizes, strict=True)
        ]
        return np.dtype([("at", "<i8"), *zip(self.columns, kinds, strict=True)])


def parse_format(raw: bytes, *, by_length: bool = False) -> MessageFormat | None:
    """The format in an FMT message of `FORMAT_BYTES` bytes; None if it is beyond repair.

    If type characters and length disagree, the characters count; with `by_length`, the length.
    """
    number, length, *texts = struct.unpack("<BB4s16s64s", raw[HEAD:FORMAT_BYTES])
    name, codes, listed = (text.split(b"\0", 1)[0].decode("latin-1") for text in texts)
    columns = [column for column in listed.split(",") if column]
    # A wrong byte may end the characters early, or follow them; then there is a column less.
    ways = [codes, texts[1].rstrip(b"\0").decode("latin-1")]
    ways += [codes[:-1]] if len(columns) == len(codes) - 1 else []
    fitting = [way for way in ways if HEAD + sum(SIZES.get(code, 0) for code in way) == length]
    fitting = [way for way in fitting if SIZES.keys() >= set(way)] or [
        way for way in ways if len(way) == len(columns)
    ]
    codes = fitting[0] if fitting else codes
    if len(columns) == len(codes) - 1:
        # A wrong byte in place of a comma: names are letters and digits.
        columns = re.sub(r"[^\w,]|[^\x00-\x7f]", ",", listed).split(",")
    sizes = [SIZES.get(code, 0) for code in codes]
    broken = [i for i, code in enumerate(codes) if code not in TYPES]
    excess = HEAD + sum(sizes) - length
    sound = not broken and excess == 0 and len(columns) == len(codes)
    if not broken and excess and len(columns) == len(codes):
        # One character became another one; the length may be wrong instead.
        could = [i for i, size in enumerate(sizes) if size - excess in SIZES.values() and i]
        if could and by_length:
            # Which of them is open: the columns between them are unreadable as a whole.
            first, behind = could[0], could[-1] + 1
            broken, codes = [first], codes[:first] + "?" + codes[behind:]
            sizes[first:behind], columns[first + 1 : behind] = [sum(sizes[first:behind])], []
    if len(broken) == 1:
        # The length gives the size of the one column that cannot be read.
        sizes[broken[0]] -= HEAD + sum(sizes) - length
        codes = "".join("?" if i in broken else code for i, code in enumerate(codes))
    if not sizes or len(broken) > 1 or min(sizes) < 1 or HEAD + sum(sizes) > 255:
        return None
    if len(columns) != len(codes):
        # Which name is split or merged is unknown: only those of a known message can be assigned.
        known = KNOWN.get(name, columns[:1])
        columns = [*known, *(f"column{i}" for i in range(len(known), len(codes)))][: len(codes)]
    taken = ("at", "")
    unique = [f"{c}_{i}" if c in (*columns[:i], *taken) else c for i, c in enumerate(columns)]
    return _named(MessageFormat(number, name, tuple(unique), codes, tuple(sizes), sound))


def _named(form: MessageFormat) -> MessageFormat:
    """Repair one wrong character of a known message's name or of one of its columns."""
    for name, first in KNOWN.items():
        own = form.columns[: len(first)]
        same = [a == b for a, b in zip(own, first, strict=False)]
        if form.name == name and len(own) == len(first) and same.count(False) == 1:
            i = same.index(False)
            # Logs up to 2015 have milliseconds.
            if own[i] != "TimeMS" and _one_wrong(own[i], first[i]):
                return replace(form, columns=(*first, *form.columns[len(first) :]))
        # Messages are named in capitals and digits.
        strange = form.name not in KNOWN and own == first
        if strange and _one_wrong(form.name.ljust(4), name.ljust(4)):
            return replace(form, name=name)
    return form


def _one_wrong(text: str, right: str) -> bool:
    return len(text) == len(right) and sum(a != b for a, b in zip(text, right, strict=True)) == 1


def find_formats(data: bytes) -> list[MessageFormat]:
    """The formats of all FMT messages in some bytes, also of those with one wrong header byte."""
    header = MAGIC + bytes((FORMATS,))
    places: set[int] = set()
    at = data.find(header)
    while at >= 0:
        places.add(at)
        at = data.find(header, at + 1)
    # FMT messages stand in a row: one with a damaged header lies where its neighbour ends.
    for at in sorted(places):
        for beside in (at - FORMAT_BYTES, at + FORMAT_BYTES):
            head = data[max(beside, 0) : max(beside, 0) + HEAD]
            if beside >= 0 and sum(a == b for a, b in zip(head, header, strict=False)) == HEAD - 1:
                places.add(beside)
    found = []
    for at in sorted(places):
        raw = data[at : at + FORMAT_BYTES]
        form = parse_format(raw) if len(raw) == FORMAT_BYTES else None
        other = parse_format(raw, by_length=True) if form and not form.sound else None
        followed = data[at + FORMAT_BYTES :][:2] in (MAGIC, b"")
        # Bytes that look like a header by chance have neither a successor nor sense.
        if form is not None and (form.sound or followed):
            found += [form, other] if other and other.length != form.length else [form]
    return found


def assign_types(
    found: list[MessageFormat], spacings: Mapping[int, Counter[int]]
) -> dict[int, MessageFormat]:
    """Formats by type; one with a wrong type gets that of the messages without a format.

    `found` are in the order of the file; `spacings` count, by type, how often the next header
    follows after how many bytes.
    """
    forms: dict[int, MessageFormat] = {}
    doubtful = []
    for form in found:
        there = forms.get(form.type)
        # Two formats of one type: the one of the right length has it.
        usual = spacings.get(form.type, Counter()).most_common(1)
        fits = there and bool(usual) and usual[0][0] == form.length != there.length
        if there is None or there.name == form.name:
            forms[form.type] = form if there is None or form.sound or fits else there
            continue
        forms[form.type], other = (form, there) if fits else (there, form)
        doubtful.append(other)
    doubtful += [form for number, form in forms.items() if not spacings.get(number)]
    names = {form.name for number, form in forms.items() if spacings.get(number)}
    for number, counts in spacings.items():
        length, times = counts.most_common(1)[0]
        if number in forms or times < 2:
            continue
        fitting = [f for f in doubtful if f.length == length and f.name not in names]
        # Types are numbered in the order of the formats; many formats are of unused types.
        near = [f for f in fitting if number in _expected(found, f)]
        fitting = near if near or len(doubtful) > FEW_UNUSED else fitting
        if len(fitting) == 1:
            forms[number] = replace(fitting[0], type=number)
    return forms


def _expected(found: list[MessageFormat], form: MessageFormat) -> set[int]:
    """The types that a format should have by those of its neighbours."""
    i = found.index(form)
    expected = {found[i - 1].type + 1} if i else set()
    return expected | ({found[i + 1].type - 1} if i + 1 < len(found) else set())

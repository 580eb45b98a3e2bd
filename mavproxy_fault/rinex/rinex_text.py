"""The lines of a RINEX file, unpacked where it is packed, and what its header says of itself."""

import re
import zlib
from collections.abc import Sequence
from pathlib import Path

from mavproxy_fault.documents.errors import ConfigError

BYTE_ORDER_MARK = b"\xef\xbb\xbf"
PACKED = (".gz", ".z", ".bz2", ".zip", ".crx", ".crx.gz")


def read_rinex_text(path: Path) -> list[str]:
    """The lines of a RINEX file, unpacked where it is compressed.

    Raises
    ------
    ConfigError
        If it cannot be read or is not RINEX.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read; {error.strerror}") from error
    if path.name.lower().endswith(PACKED) or b"CRINEX" in data[:80]:
        data = _decompressed(data, path)
    lines = data.removeprefix(BYTE_ORDER_MARK).decode("ascii", "replace").splitlines()
    if not lines or not lines[0][60:].startswith("RINEX VERSION"):
        raise ConfigError(f"{path}: is not a RINEX file; its first line must end in RINEX VERSION")
    return lines


def _decompressed(data: bytes, path: Path) -> bytes:
    import hatanaka

    try:
        unpacked: bytes = hatanaka.decompress(data)
    except (EOFError, OSError, ValueError, zlib.error, hatanaka.HatanakaException) as error:
        reason = str(error).strip().splitlines()
        raise ConfigError(
            f"{path}: cannot be decompressed ({reason[-1] if reason else type(error).__name__});"
            " a whole gzip, zip, bzip2, compress or Hatanaka file can"
        ) from error
    return unpacked


def header_of(path: Path, lines: list[str], kinds: str, called: str) -> tuple[float, int]:
    """The version of a RINEX file and where its header ends.

    Raises
    ------
    ConfigError
        If the file is of none of the `kinds`, or its header is no header.
    """
    version, kind = lines[0][:9].strip(), lines[0][20:21]
    if kind not in kinds or not kind.strip():
        raise ConfigError(f"{path}: has type {kind!r}; {called} has {kinds[0]}")
    if not re.fullmatch(r"[234](\.\d+)?", version):
        raise ConfigError(f"{path}: has version {version!r}; 2.00 to 4.02 can be read")
    end = next((i for i, line in enumerate(lines) if line[60:].startswith("END OF HEADER")), None)
    if end is None:
        raise ConfigError(f"{path}: has no END OF HEADER; the header is cut short")
    return float(version), end


def types_3(header: Sequence[str]) -> dict[str, list[str]]:
    """What a RINEX 3 or 4 observation file holds of each system, in the order of its fields."""
    types: dict[str, list[str]] = {}
    system = ""
    for line in header:
        if line[60:].startswith("SYS / # / OBS TYPES"):
            system = line[0] if line[0] != " " else system  # blank where a list goes on
            types.setdefault(system, []).extend(line[6:60].split())
    return types


def types_2(header: Sequence[str]) -> list[str]:
    """The same of a RINEX 2 file, where all systems have the same."""
    return [
        name
        for line in header
        if line[60:].startswith("# / TYPES OF OBSERV")
        for name in line[6:60].split()
    ]

"""Reads the lines of a RINEX file, compressed or not, and its header."""

import re
import zlib
from pathlib import Path

from mavproxy_fault.documents.errors import ConfigError, users_path
from mavproxy_fault.documents.extras import import_extra

BYTE_ORDER_MARK = b"\xef\xbb\xbf"
PACKED = (".gz", ".z", ".bz2", ".zip", ".crx", ".crx.gz")


def read_rinex_text(path: Path) -> list[str]:
    """Read the lines of a RINEX file, decompressed if necessary.

    Raises
    ------
    ConfigError
        If it cannot be read or is not RINEX.
    """
    lines = read_lines(path)
    if not lines or not lines[0][60:].startswith("RINEX VERSION"):
        raise ConfigError(f"{path}: is not a RINEX file; its first line must end in RINEX VERSION")
    return lines


def read_lines(path: Path) -> list[str]:
    """Read the lines of a text file, decompressed if necessary; ConfigError if that fails."""
    with users_path(path, "give a RINEX file"):
        data = path.read_bytes()
    if path.name.lower().endswith(PACKED) or b"CRINEX" in data[:80]:
        data = _decompressed(data, path)
    return data.removeprefix(BYTE_ORDER_MARK).decode("ascii", "replace").splitlines()


def _decompressed(data: bytes, path: Path) -> bytes:
    hatanaka = import_extra("hatanaka")

    try:
        unpacked: bytes = hatanaka.decompress(data)
    except (EOFError, OSError, ValueError, zlib.error, hatanaka.HatanakaException) as error:
        reason = str(error).strip().splitlines()
        raise ConfigError(
            f"{path}: cannot be decompressed ({reason[-1] if reason else type(error).__name__});"
            " give a complete gzip, zip, bzip2, compress or Hatanaka file"
        ) from error
    return unpacked


def check_header(path: Path, lines: list[str], kinds: str, called: str) -> None:
    """Raise ConfigError if a RINEX file is of none of the `kinds`, or its header is invalid."""
    version, kind = lines[0][:9].strip(), lines[0][20:21]
    if kind not in kinds or not kind.strip():
        raise ConfigError(f"{path}: has type {kind!r}; give {called}, type {kinds[0]}")
    if not re.fullmatch(r"[234](\.\d+)?", version):
        raise ConfigError(f"{path}: has version {version!r}; supported: 2.00 to 4.02")
    if not any(line[60:].startswith("END OF HEADER") for line in lines):
        raise ConfigError(f"{path}: has no END OF HEADER; give a file with a complete header")

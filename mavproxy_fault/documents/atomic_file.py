"""Files that are there whole or not at all, whenever their writer is killed."""

from pathlib import Path


def write_atomic(path: Path, text: str) -> None:
    """Write a file so that a reader sees the old one or the new one."""
    # Beside and moved: within a folder that is one step.
    fresh = path.with_name(path.name + ".new")
    # A file's name may hold bytes that are no text, and stands in what is written about it.
    fresh.write_text(text, encoding="utf-8", errors="backslashreplace")
    fresh.replace(path)

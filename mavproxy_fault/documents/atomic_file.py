"""Atomic writes: a file is complete or absent, even if its writer is killed."""

from pathlib import Path


def write_atomic(path: Path, text: str) -> None:
    """Write a file so that a reader sees either the old or the new content."""
    # Renaming within a folder is atomic.
    fresh = path.with_name(path.name + ".new")
    # The text may quote file names, which may contain bytes that are not UTF-8.
    fresh.write_text(text, encoding="utf-8", errors="backslashreplace")
    fresh.replace(path)

"""The folder in which the page stores test sequences, as schedule files."""

import re
from pathlib import Path

from mavproxy_fault.documents.errors import ConfigError, users_path

FILE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,80}\.ya?ml")


class SequenceFolder:
    """Stores sequences in a folder; without one (None) none can be stored."""

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder
        if folder is not None and not folder.is_dir():
            raise ConfigError(f"--sequences {folder}: is not a folder; give an existing one")

    def names(self) -> list[str] | None:
        """The stored files; None without a folder."""
        if self._folder is None:
            return None
        return sorted(one.name for one in self._folder.iterdir() if FILE_NAME.fullmatch(one.name))

    def read(self, name: str) -> bytes:
        """Read a stored sequence.

        Raises
        ------
        ConfigError
            If it does not exist.
        """
        with users_path(name, "give a stored sequence"):
            return self._path(name).read_bytes()

    def write(self, name: str, text: str) -> None:
        """Store a sequence under a name, replacing an earlier one.

        Raises
        ------
        ConfigError
            If it cannot be written.
        """
        with users_path(name, "give --sequences a folder that can be written to"):
            self._path(name).write_text(text, encoding="utf-8")

    def _path(self, name: str) -> Path:
        if self._folder is None:
            raise ConfigError("the page has no folder for sequences; start it with --sequences DIR")
        # A plain name and not a link: the page must not access other folders.
        path = self._folder / name
        if not FILE_NAME.fullmatch(name) or path.is_symlink():
            raise ConfigError(
                f"{name!r} is not a valid name of a sequence; use letters, digits, dots, - and _, "
                "with .yaml at the end"
            )
        return path

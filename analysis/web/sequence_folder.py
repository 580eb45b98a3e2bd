"""The folder in which the page keeps test sequences, as schedule files."""

import re
from pathlib import Path

from mavproxy_fault.documents.errors import ConfigError

FILE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,80}\.ya?ml")


class SequenceFolder:
    """The folder in which sequences are kept; None keeps none."""

    def __init__(self, folder: Path | None) -> None:
        self._folder = folder
        if folder is not None and not folder.is_dir():
            raise ConfigError(f"--sequences {folder}: is no folder; give one that is there")

    def names(self) -> list[str] | None:
        """The files there are; None where none can be kept."""
        if self._folder is None:
            return None
        return sorted(one.name for one in self._folder.iterdir() if FILE_NAME.fullmatch(one.name))

    def read(self, name: str) -> bytes:
        """One of them.

        Raises
        ------
        ConfigError
            If there is none of that name.
        """
        try:
            return self._path(name).read_bytes()
        except OSError as error:
            raise ConfigError(f"{name}: cannot be read ({error.strerror})") from None

    def write(self, name: str, text: str) -> None:
        """Keep one under a name, in the place of what had it.

        Raises
        ------
        ConfigError
            If it cannot be written.
        """
        path = self._path(name)
        try:
            path.write_text(text, encoding="utf-8")
        except OSError as error:
            raise ConfigError(f"{name}: cannot be written ({error.strerror})") from None

    def _path(self, name: str) -> Path:
        if self._folder is None:
            raise ConfigError("no folder for sequences; start the page with --sequences DIR")
        # A plain name, and no link: what lies outside of the folder is none of the page's business.
        path = self._folder / name
        if not FILE_NAME.fullmatch(name) or path.is_symlink():
            raise ConfigError(
                f"{name!r} is no name of a sequence; allowed: letters, digits, dots, - and _, "
                "with .yaml at the end"
            )
        return path

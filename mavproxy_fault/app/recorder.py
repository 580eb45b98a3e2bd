"""Recorder: a session's tlogs, labels and what a replay needs, in one folder.

    received.tlog    every frame that came, stamped with the wall clock
    sent.tlog        every frame that left, once however many links it went to
    labels.jsonl     what the faults really did
    received.other, sent.other    bytes that are no frame (see `tape`)
    received.index   link and length of everything received
    edits.jsonl      what was asked of the proxy while it ran
    session.json     links, seed, schedule and time base

Files are written whole and in order, so that a process killed at any time leaves them readable up
to the last write.
"""

import contextlib
import json
import logging
import os
from collections.abc import Sequence
from io import FileIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mavproxy_fault.documents.atomic_file import write_atomic
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.proxy.capture_buffer import CaptureBuffer

if TYPE_CHECKING:
    from mavproxy_fault.live.edit_log import Edit
    from mavproxy_fault.wire.label import Label

RECEIVED, SENT, LABELS = "received.tlog", "sent.tlog", "labels.jsonl"
RECEIVED_OTHER, SENT_OTHER = "received.other", "sent.other"
INDEX, EDITS, SESSION = "received.index", "edits.jsonl", "session.json"
LOG = logging.getLogger(__name__)
APPENDED = (RECEIVED, RECEIVED_OTHER, INDEX, SENT, SENT_OTHER, LABELS, EDITS)


class Recorder:
    """Open files of one session; `session` is what `session.json` says besides the time base.

    Where the disk is full or the folder gone, nothing is half written: what came then is left out
    and counted in `lost`, labels and edits wait, and recording begins again when it can.
    `failing` says why it stands still.
    """

    def __init__(self, folder: Path, session: dict[str, Any]) -> None:
        self.folder = folder
        self.lost = 0  # received records that were not written
        self.failing: str | None = None
        self._session = session
        self._files: dict[str, FileIO] = {}
        self._labels: list[Label] = []
        self._edits: list[Edit] = []
        try:
            folder.mkdir(parents=True, exist_ok=True)
            # An earlier session in the same folder is kept, never mixed with this one.
            _set_aside(folder)
            self._open()
        except OSError as error:
            raise ConfigError(f"{folder}: {error}; give a folder that can be written") from None

    def _open(self) -> None:
        with contextlib.ExitStack() as opened:
            files = {
                # Unbuffered: what is written survives a kill of the process.
                name: opened.enter_context((self.folder / name).open("wb", buffering=0))
                for name in APPENDED
            }
            self._write_session()
            # All could be opened: only now do they replace those before.
            opened.pop_all()
        for file in self._files.values():
            file.close()
        self._files, self._sizes = files, dict.fromkeys(APPENDED, 0)

    def write(
        self, tape: CaptureBuffer, labels: "Sequence[Label]" = (), edits: "Sequence[Edit]" = ()
    ) -> None:
        """Append and empty a tape, and append labels and edits: all of it, or what can wait later.

        Raises nothing where files cannot be written: forwarding must go on.
        """
        # Counts before and after tell how many records this tape brought.
        before = tape.drained
        drained = tape.drain()
        # Labels and edits are few and wait for better times; frames are too many.
        self._labels += labels
        self._edits += edits
        try:
            data = {
                RECEIVED: drained.received,
                RECEIVED_OTHER: drained.received_other,
                INDEX: drained.index,
                SENT: drained.sent,
                SENT_OTHER: drained.sent_other,
                LABELS: encode_lines(self._labels) if self._labels else b"",
                EDITS: encode_lines(self._edits) if self._edits else b"",
            }
            if self._is_gone():
                self.folder.mkdir(parents=True, exist_ok=True)
                self._open()
                # New files begin with this tape: the index counts from their start.
                before = tape.resume_count(tape.count - before)
            self._append(data)
        except (OSError, MemoryError) as error:
            self._note_loss(tape, before, str(error) or "no memory")
            return
        self._labels, self._edits = [], []
        if self.failing is not None:
            LOG.warning("recording goes on; %d records are missing", self.lost)
            self.failing = None

    def skip(self, tape: CaptureBuffer, why: str, more: int = 0) -> None:
        """Empty a tape without writing it down, and so many records more that never came to it."""
        before = tape.drained
        tape.clear()
        self.lost += more
        self._note_loss(tape, before, why)

    def _note_loss(self, tape: CaptureBuffer, before: int, why: str) -> None:
        """Count a tape that was not written; `before` are the records that are in the files."""
        # The index must fit the files: what was not written has not come.
        self.lost += tape.count - before
        tape.resume_count(before)
        self._edits = [edit.at_record(before) for edit in self._edits]
        # Said once, not each second.
        if self.failing is None:
            LOG.warning("recording stops, forwarding goes on: %s", why)
        self.failing = why

    def _is_gone(self) -> bool:
        """Whether somebody removed the files, or replaced the disk that failed."""
        held = os.fstat(self._files[RECEIVED].fileno())
        if held.st_nlink == 0:  # no name is left, although the open file still takes what comes
            return True
        if self.failing is None:
            return False
        try:
            return not os.path.samestat(held, (self.folder / RECEIVED).stat())
        except FileNotFoundError:
            return True

    def _append(self, data: dict[str, bytes]) -> None:
        """Append to all files, or to none."""
        if self.failing is not None:  # a disk that failed may not have let itself be cut either
            for name in self._sizes:
                self._cut(name)
        try:
            for name, added in data.items():
                _write_whole(self._files[name], added)
        except (OSError, MemoryError):
            for name in self._sizes:
                with contextlib.suppress(OSError):
                    self._cut(name)
            raise
        for name, added in data.items():
            self._sizes[name] += len(added)

    def _cut(self, name: str) -> None:
        """Take back what a file has behind its last whole record."""
        # Half a record would make the rest of the file unreadable by its index.
        self._files[name].truncate(self._sizes[name])
        # Behind the cut, or the next write would leave a hole of zeros.
        self._files[name].seek(self._sizes[name])

    def close(self, t0_us: int | None, end_us: int) -> None:
        """Close the files; note the first vehicle stamp and the wall time of the end."""
        # Known only at the end: with them a replay ends where the session did.
        self._session |= {"t0_us": t0_us, "end_us": end_us}
        if self.lost:
            self._session["lost_records"] = self.lost
        try:
            for file in self._files.values():
                file.close()
            self._write_session()
        except OSError as error:
            LOG.warning("the session's end was not recorded: %s", error)

    def _write_session(self) -> None:
        write_atomic(self.folder / SESSION, json.dumps(self._session, indent=1) + "\n")


def _write_whole(file: FileIO, data: bytes) -> None:
    """Write all of it; a file that is nearly full takes a part and raises at the next attempt."""
    # A view: no copy of the rest for each part.
    rest = memoryview(data)
    while rest:
        rest = rest[file.write(rest) :]


def encode_lines(lines: "Sequence[Label | Edit]") -> bytes:
    """Labels or edits as JSON lines."""
    from msgspec.json import encode  # 0.1 s that a proxy without faults need not pay

    return b"".join(encode(line) + b"\n" for line in lines)


def _set_aside(folder: Path) -> None:
    """Move an earlier session's files into a numbered folder of their own."""
    present = [folder / name for name in (*APPENDED, SESSION) if (folder / name).exists()]
    if not present:
        return
    number = 1
    while (folder / f"earlier-{number}").exists():
        number += 1
    aside = folder / f"earlier-{number}"
    aside.mkdir()
    for path in present:
        path.rename(aside / path.name)

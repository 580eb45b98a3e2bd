"""Recorder: writes a session's tlogs, labels and replay data to one folder.

    received.tlog    every received frame, with its wall time
    sent.tlog        every sent frame, once even if it went to several links
    labels.jsonl     the applied faults
    received.other, sent.other    bytes that are not a frame
    received.index   link and length of everything received
    edits.jsonl      the edit log: live requests
    session.json     links, seed, schedule and time base

Complete records are appended in order, so that a kill at any time leaves the files readable up to
the last write.
"""

import contextlib
import json
import logging
import os
from collections.abc import Sequence
from io import FileIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mavproxy_fault.documents.atomic_file import PRIVATE, create_file, write_all, write_atomic
from mavproxy_fault.documents.errors import users_path
from mavproxy_fault.proxy.capture_buffer import CaptureBuffer
from mavproxy_fault.wire.dialect_files import record_dialects

if TYPE_CHECKING:
    from mavproxy_fault.live.edit_log import Edit
    from mavproxy_fault.wire.label import Label

RECEIVED, SENT, LABELS = "received.tlog", "sent.tlog", "labels.jsonl"
RECEIVED_OTHER, SENT_OTHER = "received.other", "sent.other"
INDEX, EDITS, SESSION = "received.index", "edits.jsonl", "session.json"
LOG = logging.getLogger(__name__)
APPENDED = (RECEIVED, RECEIVED_OTHER, INDEX, SENT, SENT_OTHER, LABELS, EDITS)


class Recorder:
    """The files of one session; `session` is the content of `session.json` without the time base.

    While the disk is full or the folder missing, complete records are dropped and counted in
    `lost`, labels and edits are retained, and recording resumes as soon as it can. `failing` is
    the reason, None while recording works.
    """

    def __init__(self, folder: Path, session: dict[str, Any]) -> None:
        self.folder = folder
        self.lost = 0  # received records that were not written
        self.failing: str | None = None
        self._session = session | record_dialects()
        self._files: dict[str, FileIO] = {}
        self._labels: list[Label] = []
        self._edits: list[Edit] = []
        with users_path(folder, "give a folder that can be written to"):
            self._open()

    def _open(self) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        # An earlier session in this folder is moved aside.
        _move_earlier_session(self.folder)
        with contextlib.ExitStack() as opened:
            files = {
                # Unbuffered, so that a kill of the process loses no written record.
                name: opened.enter_context(create_file(self.folder / name))
                for name in APPENDED
            }
            self._write_session()
            # All are open and now replace the previous files.
            opened.pop_all()
        for file in self._files.values():
            file.close()
        self._files, self._sizes = files, dict.fromkeys(APPENDED, 0)

    def write(
        self, tape: CaptureBuffer, labels: "Sequence[Label]" = (), edits: "Sequence[Edit]" = ()
    ) -> None:
        """Append the capture buffer (which is emptied), labels and edits to the files.

        A write error is logged, not raised: forwarding must continue.
        """
        # The counts before and after give the number of new records.
        before = tape.drained
        drained = tape.drain()
        # Labels and edits are few and are retained on failure; frames are too many.
        self._labels += labels
        self._edits += edits
        try:
            data: dict[str, bytes | bytearray] = {
                RECEIVED: drained.received,
                RECEIVED_OTHER: drained.received_other,
                INDEX: drained.index,
                SENT: drained.sent,
                SENT_OTHER: drained.sent_other,
                LABELS: encode_lines(self._labels) if self._labels else b"",
                EDITS: encode_lines(self._edits) if self._edits else b"",
            }
            if self._files_missing():
                self._open()
                # The new files begin with this buffer, and so does the index.
                before = tape.resume_count(tape.count - before)
            self._append(data)
        except (OSError, MemoryError) as error:
            self._note_loss(tape, before, str(error) or "no memory")
            return
        self._labels, self._edits = [], []
        if self.failing is not None:
            LOG.warning("recording resumed; %d records are missing", self.lost)
            self.failing = None

    def skip(self, tape: CaptureBuffer, why: str, more: int = 0) -> None:
        """Discard the capture buffer and count it as lost, with `more` records outside of it."""
        before = tape.drained
        tape.drain()
        self.lost += more
        self._note_loss(tape, before, why)

    def _note_loss(self, tape: CaptureBuffer, before: int, why: str) -> None:
        """Count an unwritten buffer as lost; `before` is the number of records in the files."""
        # The index must match the files, so unwritten records do not count as received.
        self.lost += tape.count - before
        tape.resume_count(before)
        self._edits = [edit.at_record(before) for edit in self._edits]
        # Logged once, not every second.
        if self.failing is None:
            LOG.warning("recording stopped, forwarding continues: %s", why)
        self.failing = why

    def _files_missing(self) -> bool:
        """Whether the files were removed, or a failed disk was replaced."""
        held = os.fstat(self._files[RECEIVED].fileno())
        if held.st_nlink == 0:  # deleted, although the open file still accepts writes
            return True
        if self.failing is None:
            return False
        try:
            return not os.path.samestat(held, (self.folder / RECEIVED).stat())
        except FileNotFoundError:
            return True

    def _append(self, data: dict[str, bytes | bytearray]) -> None:
        """Append to all files, or to none."""
        if self.failing is not None:  # truncation may have failed too
            for name in self._sizes:
                self._truncate(name)
        try:
            for name, added in data.items():
                write_all(self._files[name], added)
        except (OSError, MemoryError):
            for name in self._sizes:
                with contextlib.suppress(OSError):
                    self._truncate(name)
            raise
        for name, added in data.items():
            self._sizes[name] += len(added)

    def _truncate(self, name: str) -> None:
        """Truncate a file after its last complete record."""
        # A partial record would misalign the index.
        self._files[name].truncate(self._sizes[name])
        # Else the next write would leave a gap of zeros.
        self._files[name].seek(self._sizes[name])

    def close(self, t0_us: int | None, end_us: int) -> None:
        """Close the files and store the first vehicle timestamp and the wall time of the end."""
        # With them a replay ends where the session did.
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
        write_atomic(self.folder / SESSION, json.dumps(self._session, indent=1) + "\n", PRIVATE)


def encode_lines(lines: "Sequence[Label | Edit]") -> bytes:
    """Encode labels or edits as JSON lines."""
    from msgspec.json import encode  # imported late: 0.1 s that a proxy without faults saves

    return b"".join(encode(line) + b"\n" for line in lines)


def _move_earlier_session(folder: Path) -> None:
    """Move the files of an earlier session, and links under their names, to a numbered folder."""
    present = [folder / name for name in (*APPENDED, SESSION) if os.path.lexists(folder / name)]
    if not present:
        return
    number = 1
    while (folder / f"earlier-{number}").exists():
        number += 1
    aside = folder / f"earlier-{number}"
    aside.mkdir()
    for path in present:
        path.rename(aside / path.name)

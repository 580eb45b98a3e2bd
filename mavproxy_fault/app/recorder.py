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

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mavproxy_fault.proxy.tape import Tape

if TYPE_CHECKING:
    from mavproxy_fault.live.journal import Edit
    from mavproxy_fault.wire.label import Label

RECEIVED, SENT, LABELS = "received.tlog", "sent.tlog", "labels.jsonl"
RECEIVED_OTHER, SENT_OTHER = "received.other", "sent.other"
INDEX, EDITS, SESSION = "received.index", "edits.jsonl", "session.json"
APPENDED = (RECEIVED, RECEIVED_OTHER, INDEX, SENT, SENT_OTHER, LABELS, EDITS)


class Recorder:
    """Open files of one session; `session` is what `session.json` says besides the time base."""

    def __init__(self, folder: Path, session: dict[str, Any]) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        _set_aside(folder)
        self.folder = folder
        self._session = session
        self._files = {name: (folder / name).open("wb", buffering=0) for name in APPENDED}
        self._write_session()

    def write(
        self, tape: Tape, labels: "Sequence[Label]" = (), edits: "Sequence[Edit]" = ()
    ) -> None:
        """Append and empty a tape, and append labels and edits."""
        taken = tape.take()
        for name, data in (
            (RECEIVED, taken.received),
            (RECEIVED_OTHER, taken.received_other),
            (INDEX, taken.index),
            (SENT, taken.sent),
            (SENT_OTHER, taken.sent_other),
        ):
            if data:
                self._files[name].write(data)
        if labels:
            self._files[LABELS].write(encoded(labels))
        if edits:
            self._files[EDITS].write(encoded(edits))

    def close(self, t0_us: int | None, end_us: int) -> None:
        """Close the files; note the first vehicle stamp and the wall time of the end."""
        for file in self._files.values():
            file.close()
        self._session |= {"t0_us": t0_us, "end_us": end_us}
        self._write_session()

    def _write_session(self) -> None:
        fresh = self.folder / (SESSION + ".new")
        fresh.write_text(json.dumps(self._session, indent=1) + "\n")
        fresh.replace(self.folder / SESSION)


def encoded(lines: "Sequence[Label | Edit]") -> bytes:
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

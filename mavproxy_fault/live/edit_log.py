"""The edit log: the live requests of a session, recorded so that a replay can repeat them.

MAV_CMD_INJECT_FAILURE is a frame and already in the tlog; Zenoh queries, RflySim packets and the
time at which live control started are not.
"""

import contextlib
from collections.abc import Iterable
from pathlib import Path

import msgspec

from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.live.control import LiveControl
from mavproxy_fault.proxy.capture_buffer import CaptureBuffer
from mavproxy_fault.proxy.core import Core

JOIN, RFLYSIM = "join", "rflysim"
MOST_LISTED = 5


class Edit(msgspec.Struct, frozen=True):
    """One request: the number of records received before it, its time and its content.

    `what` is a Zenoh key, `rflysim` or `join`; `payload` is text, or a packet in hexadecimal.
    """

    at: int
    now_us: int
    t_us: int
    what: str
    payload: str = ""

    def at_record(self, count: int) -> "Edit":
        """Limit the record count, where later records were not written."""
        return msgspec.structs.replace(self, at=min(self.at, count))


class EditLog:
    """Collects the edits of a session for its recorder; inactive without a capture buffer."""

    def __init__(self, core: Core, tape: CaptureBuffer | None) -> None:
        self._core = core
        self._tape = tape
        self._edits: list[Edit] = []
        self._now_us = 0

    def begin(self, now_us: int) -> int:
        """Return the vehicle's time for an edit (the wall clock until that is known).

        Frames due by `now_us` must have been sent already, as in the replay.
        """
        self._now_us = now_us
        self._core.advance_link(now_us)
        clock = self._core.clock
        return now_us if clock.t0_us is None else clock.t_us

    def note(self, what: str, payload: bytes, t_us: int) -> None:
        """Append one edit, made at the vehicle's time `t_us`."""
        if self._tape is not None:
            # A packet is binary and stored as hexadecimal digits.
            text = payload.hex() if what == RFLYSIM else payload.decode("utf-8", "replace")
            self._edits.append(Edit(self._tape.count, self._now_us, t_us, what, text))

    def drain(self) -> list[Edit]:
        """Return the edits since the last call."""
        edits, self._edits = self._edits, []
        return edits


def read_edits(path: Path) -> list[Edit]:
    """Read the complete lines of an edit log; empty if the file does not exist."""
    lines = path.read_bytes().splitlines(keepends=True) if path.is_file() else []
    # A kill may have truncated the last line.
    return [msgspec.json.decode(line, type=Edit) for line in lines if line.endswith(b"\n")]


def describe_edits(edits: Iterable[Edit], t0_us: int) -> list[str]:
    """Describe the edits for the summary: the first few with their times, and how many more.

    They show that the run deviated from its scenario.
    """
    requests = [edit for edit in edits if edit.what != JOIN]
    lines = [
        f"{(edit.t_us - t0_us) * 1e-6:.1f} s {edit.what.rpartition('@ctl/')[2]} {edit.payload}"
        for edit in requests[:MOST_LISTED]
    ]
    omitted = len(requests) - len(lines)
    return [*lines, f"and {omitted} more"] if omitted else lines


def apply_edit(edit: Edit, core: Core, control: LiveControl) -> None:
    """Apply a recorded edit; an edit that was refused is refused again."""
    if edit.what == JOIN:
        join_live_control(core, control)
        return
    core.advance_link(edit.now_us)
    control.replayed_us = edit.now_us
    # The replay refuses what the running proxy refused.
    with contextlib.suppress(ConfigError):
        if edit.what == RFLYSIM:
            control.packet(bytes.fromhex(edit.payload), edit.t_us)
        else:
            control.answer(edit.what, edit.payload.encode(), edit.t_us)


def join_live_control(core: Core, control: LiveControl) -> None:
    """Attach live control to the core; its engine is used if the core has none."""
    if core.engine is None:
        if core.clock.t0_us is not None:
            # The engine's time counts from the vehicle's first timestamp, which may be long past.
            control.engine.start_at(core.clock.t0_us)
        core.engine = control.engine
    core.attach(control)

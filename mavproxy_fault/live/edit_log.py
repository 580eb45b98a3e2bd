"""Edits: what was asked of a running proxy, recorded so that a replay can ask it again.

Commands that passed as frames (MAV_CMD_INJECT_FAILURE) are in the log already; requests of the bus
and RflySim's packets are not, nor is the moment from which live control took part.
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
    """One request: after how many received records, when, and what.

    `what` is a key of the bus, `rflysim` or `join_live_control`; `payload` is text, of a packet its
    digits.
    """

    at: int
    now_us: int
    t_us: int
    what: str
    payload: str = ""

    def at_record(self, count: int) -> "Edit":
        """The same after no more than so many records, where later ones were not kept."""
        return msgspec.structs.replace(self, at=min(self.at, count))


class EditLog:
    """Notes the edits of a session, for its recorder; without a tape there is nothing to note."""

    def __init__(self, core: Core, tape: CaptureBuffer | None) -> None:
        self._core = core
        self._tape = tape
        self._edits: list[Edit] = []
        self._now_us = 0

    def begin(self, now_us: int) -> int:
        """The vehicle's time (the wall clock before it is known), at which an edit may be made.

        What was due by `now_us` must have left, as it has when the session is replayed.
        """
        self._now_us = now_us
        clock = self._core.clock
        return now_us if clock.t0_us is None else clock.t_us

    def note(self, what: str, payload: bytes, t_us: int) -> None:
        """Keep one edit, made at the vehicle's time `t_us`."""
        if self._tape is not None:
            # Digits, since a packet is no text.
            text = payload.hex() if what == RFLYSIM else payload.decode("utf-8", "replace")
            self._edits.append(Edit(self._tape.count, self._now_us, t_us, what, text))

    def drain(self) -> list[Edit]:
        """The edits since the last call."""
        edits, self._edits = self._edits, []
        return edits


def read_edits(path: Path) -> list[Edit]:
    """The whole lines of a file of edits; none if there is no such file."""
    lines = path.read_bytes().splitlines(keepends=True) if path.is_file() else []
    # A kill may have cut the last line.
    return [msgspec.json.decode(line, type=Edit) for line in lines if line.endswith(b"\n")]


def describe_edits(edits: Iterable[Edit], t0_us: int) -> list[str]:
    """What was asked from outside, for people: the first few with their seconds, and how many more.

    A run that somebody else edits is no longer what its scenario says.
    """
    asked = [edit for edit in edits if edit.what != JOIN]
    lines = [
        f"{(edit.t_us - t0_us) * 1e-6:.1f} s {edit.what.rpartition('@ctl/')[2]} {edit.payload}"
        for edit in asked[:MOST_LISTED]
    ]
    more = len(asked) - len(lines)
    return [*lines, f"and {more} more"] if more else lines


def apply_edit(edit: Edit, core: Core, control: LiveControl) -> None:
    """Do once more what was asked for; what was refused is refused again."""
    if edit.what == JOIN:
        join_live_control(core, control)
        return
    # What the running proxy refused, the replay refuses as well.
    with contextlib.suppress(ConfigError):
        if edit.what == RFLYSIM:
            control.packet(bytes.fromhex(edit.payload), edit.t_us)
        else:
            control.answer(edit.what, edit.payload.encode(), edit.t_us)


def join_live_control(core: Core, control: LiveControl) -> None:
    """Let live control take part; its engine takes over if there was none."""
    if core.engine is None:
        if core.clock.t0_us is not None:
            # The engine's time counts from the vehicle's first stamp, which may have come long ago.
            control.engine.start_at(core.clock.t0_us)
        core.engine = control.engine
    core.control = control

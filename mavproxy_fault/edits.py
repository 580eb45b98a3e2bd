"""Edits: what was asked of a running proxy, recorded so that a replay can ask it again.

Commands that passed as frames (MAV_CMD_INJECT_FAILURE) are in the log already; requests of the bus
and RflySim's packets are not, nor is the moment from which live control took part.
"""

import contextlib
from pathlib import Path

import msgspec

from mavproxy_fault.control import Control
from mavproxy_fault.core import Core
from mavproxy_fault.errors import ConfigError

JOIN, RFLYSIM = "join", "rflysim"


class Edit(msgspec.Struct, frozen=True):
    """One request: after how many received records, when, and what.

    `what` is a key of the bus, `rflysim` or `join`; `payload` is text, of a packet its digits.
    """

    at: int
    now_us: int
    t_us: int
    what: str
    payload: str = ""


def read_edits(path: Path) -> list[Edit]:
    """The whole lines of a file of edits; none if there is no such file."""
    lines = path.read_bytes().splitlines(keepends=True) if path.is_file() else []
    return [msgspec.json.decode(line, type=Edit) for line in lines if line.endswith(b"\n")]


def carry_out(edit: Edit, core: Core, control: Control) -> None:
    """Do once more what was asked for; what was refused is refused again."""
    if edit.what == JOIN:
        join(core, control)
        return
    with contextlib.suppress(ConfigError):
        if edit.what == RFLYSIM:
            control.packet(bytes.fromhex(edit.payload), edit.t_us)
        else:
            control.answer(edit.what, edit.payload.encode(), edit.t_us)


def join(core: Core, control: Control) -> None:
    """Let live control take part; its engine takes over if there was none."""
    if core.engine is None:
        if core.clock.t0_us is not None:
            control.engine.start_at(core.clock.t0_us)
        core.engine = control.engine
    core.control = control

"""A stretch of plain steps with its system calls and the proxy's passage, compiled.

An answer is waited for, passes the proxy, is flown, and the frames of the step pass the proxy and
leave: over and over, until something needs the interpreter. Structures are those of 64-bit Linux,
as in `compiled.sockets`.
"""

from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.extending import intrinsic

from mavproxy_fault.compiled import layout as c
from mavproxy_fault.numerics.compile import compiled, inlined, unlocked
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import STX_V2
from simvehicle.plain import plain_arrays as k
from simvehicle.plain.plain_arrays import Integers, Octets, Plain
from simvehicle.plain.step_kernel import command, look_ahead, step
from simvehicle.vehicles.actuators import ARMED_FLAG, CHANNEL_COUNT

# Entries of `words`; the last two are numbers of links
(FD, UNTIL_US, LEFT, STEP_US, START_US, FORWARD, ADDRESSES, GOT, WENT, STEPS, BYTES_IN,
 BYTES_OUT, ANSWERED_US, SIMULATOR, VEHICLE, WORDS) = range(16)  # fmt: skip
# Why a stretch ends: its time, bytes that the inbox has to take, frames that the core has to take,
# bytes that have not left, no answer, a state beyond the numbers
OVER, CAME, KEPT, STAYED, SILENT, DIVERGED = range(6)
WAIT_MS = 50  # for an answer, before the loop has a look at its time-outs
ROOM = 32_768
DONTWAIT, NOSIGNAL, POLLIN = 0x40, 0x4000, 1

HIL_ACTUATOR_CONTROLS = message_layout("HIL_ACTUATOR_CONTROLS")
_ANSWER = HIL_ACTUATOR_CONTROLS.id
_HEAD, _CRC = 10, 2
_STAMP, _CHANNELS, _MODE, _SIZE = 0, 16, 80, 81  # places in its payload

_poll = types.ExternalFunction("poll", types.intc(types.intp, types.uintp, types.intc))
_recv = types.ExternalFunction("recv", types.intp(types.intc, types.intp, types.uintp, types.intc))
_send = types.ExternalFunction("send", types.intp(types.intc, types.intp, types.uintp, types.intc))


class Stretch(NamedTuple):
    """The arrays of a stretch besides those of `Plain`."""

    words: Integers  # (WORDS,)
    poll: Integers  # (1,) `pollfd` of the HIL link
    came: Octets  # (ROOM,) the newest bytes of the autopilot
    loop: Integers  # the compiled proxy's own
    data: Octets  # and its room for a datagram


@intrinsic  # type: ignore[untyped-decorator]
def _called(_: Any, function: Any, argument: Any) -> Any:
    """The result of a function of one address, called at its own."""

    def code(__: Any, builder: Any, ___: Any, values: Any) -> Any:
        word = ir.IntType(64)
        kind = ir.FunctionType(word, [word]).as_pointer()
        return builder.call(builder.inttoptr(values[0], kind), [values[1]])

    return types.int64(types.int64, types.int64), code


@inlined
def _passed(s: Stretch, link: int, length: int, now_us: int) -> int:
    """The links that a datagram in `data` leaves on, changed there; -1 if the core has to take it;
    as `Passage.passed`."""
    loop, words = s.loop, s.words
    loop[c.LENT], loop[c.LINK], loop[c.CAME] = length, link, now_us
    _called(words[FORWARD], words[ADDRESSES])
    return int(loop[c.MASK])


@compiled
def _await(s: Stretch) -> int:
    """Wait for the autopilot; CAME, or why nothing was received."""
    words = s.words
    s.poll[0] = words[FD] | POLLIN << 32
    if _poll(s.poll.ctypes.data, 1, WAIT_MS) <= 0:
        return SILENT
    words[GOT] = _recv(words[FD], s.came.ctypes.data, ROOM, DONTWAIT)
    if words[GOT] <= 0:
        return SILENT
    words[BYTES_IN] += words[GOT]
    return CAME


@inlined
def _answers(s: Stretch) -> bool:
    """Whether the received bytes are exactly one complete answer to the last step."""
    came, words = s.came, s.words
    if words[GOT] != _HEAD + _SIZE + _CRC or came[0] != STX_V2 or came[1] != _SIZE:
        return False
    number = np.int64(came[7]) | np.int64(came[8]) << 8 | np.int64(came[9]) << 16
    stamp_us = came[_HEAD + _STAMP : _HEAD + _STAMP + 8].view(np.int64)[0]
    return bool(number == _ANSWER and came[2] == 0 and stamp_us == words[STEP_US])


@compiled
def _obey(p: Plain, payload: Octets) -> None:
    """Apply the commands in an answer's payload (81,)."""
    p.words[k.ARMED] = payload[_MODE] & ARMED_FLAG
    command(p, payload[_CHANNELS : _CHANNELS + 4 * CHANNEL_COUNT].view(np.float32))


@compiled
def _leave(p: Plain, s: Stretch) -> int:
    """Send the frames of a step through the proxy; OVER, or why some were not sent."""
    words, length = s.words, p.words[k.LENGTH]
    s.data[:length] = p.out[:length]
    mask = _passed(s, words[SIMULATOR], length, p.words[k.T_US] + words[START_US])
    if mask < 0 or not mask >> words[VEHICLE] & 1:
        return KEPT
    words[STEP_US] = p.words[k.T_US] + p.words[k.START_US]
    words[WENT] = _send(words[FD], s.data.ctypes.data, length, DONTWAIT | NOSIGNAL)
    if words[WENT] > 0:
        words[BYTES_OUT] += words[WENT]
    return OVER if words[WENT] == length else STAYED


@unlocked
def stretch(p: Plain, s: Stretch) -> int:
    """Fly plain steps as their answers arrive; return why it ended.

    The step after the last one is looked ahead to; LEFT steps and those before UNTIL_US are plain.
    """
    words = s.words
    while words[LEFT] > 0 and p.words[k.NEXT_US] < words[UNTIL_US]:
        reason = _await(s)
        if reason != CAME:
            return reason
        if not _answers(s):
            return CAME
        length = words[GOT]
        s.data[:length] = s.came[:length]
        mask = _passed(s, words[VEHICLE], length, p.words[k.T_US] + words[START_US])
        if mask < 0:
            return CAME
        words[ANSWERED_US] = words[STEP_US]
        if mask >> words[SIMULATOR] & 1:
            _obey(p, s.data[_HEAD : _HEAD + _SIZE])
        if not step(p):
            return DIVERGED
        words[STEPS] += 1
        words[LEFT] -= 1
        reason = _leave(p, s)
        look_ahead(p)
        if reason != OVER:
            return reason
    return OVER

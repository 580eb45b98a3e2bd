"""A stretch of steps with its system calls and the proxy's passage, compiled.

An answer is waited for, passes the proxy, is flown, and the frames of the step pass the proxy and
leave: over and over, until something needs the interpreter. Structures are those of 64-bit Linux.
"""

from typing import Any

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from mavproxy_fault.compiled import layout as c
from mavproxy_fault.numerics.compile import compiled, inlined, unlocked
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import STX_V2
from simvehicle.hil.frame_kernel import pack_sensors, pack_truth
from simvehicle.sensors.flight_record import Records
from simvehicle.simulation.step_kernel import prepare, step
from simvehicle.vehicles.actuators import (
    ARMED_FLAG,
    CHANNEL_COUNT,
    MODE,
    PAYLOAD_SIZE,
    STAMP,
    mix_channels,
    read_channels,
)

Integers = NDArray[np.int64]
Octets = NDArray[np.uint8]
Doubles = NDArray[np.float64]

# Why a stretch ends: its time, bytes that the inbox has to take, frames that the core has to take,
# bytes that have not left, no answer, a state that has diverged, an answer that the core has to
# finish
OVER, CAME, KEPT, STAYED, SILENT, DIVERGED, ANSWERED = range(7)
WAIT_MS = 50  # for an answer, before the loop has a look at its time-outs
ROOM = 32_768
DONTWAIT, NOSIGNAL, POLLIN = 0x40, 0x4000, 1

HIL_ACTUATOR_CONTROLS = message_layout("HIL_ACTUATOR_CONTROLS")
_ANSWER = HIL_ACTUATOR_CONTROLS.id
_HEAD, _CRC = 10, 2

STRETCH = np.dtype(
    [
        ("fd", "i8"),  # of the HIL link
        ("poll", "i8", (1,)),  # its `pollfd`
        ("simulator", "i8"),  # numbers of links
        ("vehicle", "i8"),
        ("forward", "i8"),  # addresses of the proxy's function and of its argument
        ("addresses", "i8"),
        ("unix_us", "i8"),  # the proxy's time at the flight's t_us = 0
        ("until_us", "i8"),  # only earlier steps are flown
        ("step_us", "i8"),  # timestamp of the last step, and of the last answer
        ("answered_us", "i8"),
        ("steps", "i8"),  # how many were flown
        ("bytes_in", "i8"),
        ("bytes_out", "i8"),
        ("got", "i8"),  # length of the newest bytes of the autopilot
        ("went", "i8"),  # how much of the last step has left
        ("came", "u1", ROOM),  # the newest bytes of the autopilot
        ("channels", "f8", CHANNEL_COUNT),
    ],
    align=True,
)

_poll = types.ExternalFunction("poll", types.intc(types.intp, types.uintp, types.intc))
_recv = types.ExternalFunction("recv", types.intp(types.intc, types.intp, types.uintp, types.intc))
_send = types.ExternalFunction("send", types.intp(types.intc, types.intp, types.uintp, types.intc))


@intrinsic  # type: ignore[untyped-decorator]
def _called(_: Any, function: Any, argument: Any) -> Any:
    """The result of a function of one address, called at its own."""

    def code(__: Any, builder: Any, ___: Any, values: Any) -> Any:
        word = ir.IntType(64)
        kind = ir.FunctionType(word, [word]).as_pointer()
        return builder.call(builder.inttoptr(values[0], kind), [values[1]])

    return types.int64(types.int64, types.int64), code


@inlined
def _passed(s: Any, loop: Integers, link: int, length: int, t_us: int) -> int:
    """The links that a datagram in the proxy's room leaves on, changed there; UNTOUCHED or BEGUN if
    the core has to finish it."""
    loop[c.LENT], loop[c.LINK], loop[c.CAME] = length, link, 1000 * (t_us + s.unix_us)
    _called(s.forward, s.addresses)
    return int(loop[c.MASK])


@compiled
def _await(stretch: Records) -> int:
    """Wait for the autopilot; CAME, or why nothing was received."""
    s = stretch[0]
    s.poll[0] = s.fd | POLLIN << 32
    if _poll(s.poll.ctypes.data, 1, WAIT_MS) <= 0:
        return SILENT
    s.got = _recv(s.fd, s.came.ctypes.data, ROOM, DONTWAIT)
    if s.got <= 0:
        return SILENT
    s.bytes_in += s.got
    return CAME


@inlined
def _answers(s: Any) -> bool:
    """Whether the received bytes are exactly one complete answer to the last step."""
    came = s.came
    if s.got != _HEAD + PAYLOAD_SIZE + _CRC or came[0] != STX_V2 or came[1] != PAYLOAD_SIZE:
        return False
    number = np.int64(came[7]) | np.int64(came[8]) << 8 | np.int64(came[9]) << 16
    stamp_us = came[_HEAD + STAMP : _HEAD + STAMP + 8].view(np.int64)[0]
    return bool(number == _ANSWER and came[2] == 0 and stamp_us == s.step_us)


@compiled
def _obey(flight: Records, stretch: Records, payload: Octets) -> None:
    """Apply the commands in an answer's payload (81,); without arming all are 0."""
    f, s = flight[0], stretch[0]
    f.armed = payload[MODE] & ARMED_FLAG
    read_channels(payload, s.channels)
    mix_channels(s.channels, f.wing, f.controls[: f.actuators])
    if not f.armed:
        for i in range(f.actuators):
            f.controls[i] = 0.0


@compiled
def _leave(flight: Records, packer: Records, stretch: Records, loop: Integers, data: Octets) -> int:
    """Send the frames of a step through the proxy; OVER, or why some were not sent."""
    f, w, s = flight[0], packer[0], stretch[0]
    for i in range(w.length):
        data[i] = w.out[i]
    mask = _passed(s, loop, s.simulator, w.length, f.t_us)
    if mask < 0 or not mask >> s.vehicle & 1:
        return KEPT
    s.step_us = f.t_us + w.start_us
    s.went = _send(s.fd, data.ctypes.data, w.length, DONTWAIT | NOSIGNAL)
    if s.went > 0:
        s.bytes_out += s.went
    return OVER if s.went == w.length else STAYED


@unlocked
def fly_stretch(
    flight: Records,
    sensors: Records,
    packed: Doubles,
    packer: Records,
    stretch: Records,
    loop: Integers,
    data: Octets,
) -> int:
    """Fly steps as their answers arrive; return why it ended.

    `loop` and `data` are the proxy's own, and its room for a datagram. The step after the last one
    is prepared, unless random numbers are used up.
    """
    f, s = flight[0], stretch[0]
    while f.prepared and not f.used_up and f.next_us < s.until_us:
        reason = _await(stretch)
        if reason != CAME:
            return reason
        if not _answers(s):
            return CAME
        for i in range(s.got):
            data[i] = s.came[i]
        mask = _passed(s, loop, s.vehicle, s.got, f.t_us)
        if mask < 0:
            return CAME if mask == c.UNTOUCHED else ANSWERED
        s.answered_us = s.step_us
        if mask >> s.simulator & 1:
            _obey(flight, stretch, data[_HEAD : _HEAD + PAYLOAD_SIZE])
        if not step(flight, sensors, packed):
            return DIVERGED
        pack_sensors(flight, sensors, packer)
        pack_truth(flight, packer)
        s.steps += 1
        reason = _leave(flight, packer, stretch, loop, data)
        if not f.used_up:
            prepare(flight)
        if reason != OVER:
            return reason
    return OVER

"""The compiled form's signatures: checked, made and stripped as `wire.signing` does.

That calls SHA-256 of Python's library, here stands its compression function [1]_.

References
----------
.. [1] NIST FIPS 180-4, "Secure Hash Standard", section 6.2.2.
"""

from typing import Any, cast

import numpy as np

from mavproxy_fault.compiled import layout as k
from mavproxy_fault.compiled.element_bytes import little_endian
from mavproxy_fault.compiled.kernel import i64, kernel, kernel_of
from mavproxy_fault.compiled.layout import Shared
from mavproxy_fault.numerics.sha256 import ROUNDS, STATE
from mavproxy_fault.wire import signing
from mavproxy_fault.wire.frame import SIGNATURE_LENGTH, SIGNED
from mavproxy_fault.wire.framing import range_crc
from mavproxy_fault.wire.signing import DIGEST_LENGTH, KEY_LENGTH

u32 = cast(Any, np.uint32)
UNDIGESTED = SIGNATURE_LENGTH - DIGEST_LENGTH  # link id and timestamp, which are signed too
BLOCK = 64  # bytes

stream_cell = kernel_of(signing.stream_cell)


@kernel
def _rotated(word: Any, count: int) -> Any:
    return u32(word >> u32(count)) | u32(word << u32(32 - count))


@kernel
def _compress(block: int, shared: Shared) -> None:
    """Add a block of `message` to the state."""
    w, state, constants = shared.sha_words, shared.sha_state, shared.sha_constants
    for n in range(16):
        at = block + 4 * n
        m = shared.message
        w[n] = (
            u32(m[at]) << u32(24) | u32(m[at + 1]) << u32(16) | u32(m[at + 2]) << u32(8) | m[at + 3]
        )
    for n in range(16, ROUNDS):
        x, y = u32(w[n - 15]), u32(w[n - 2])
        s0 = _rotated(x, 7) ^ _rotated(x, 18) ^ u32(x >> u32(3))
        s1 = _rotated(y, 17) ^ _rotated(y, 19) ^ u32(y >> u32(10))
        w[n] = u32(w[n - 16] + s0 + w[n - 7] + s1)
    a, b, c, d = u32(state[0]), u32(state[1]), u32(state[2]), u32(state[3])
    e, f, g, h = u32(state[4]), u32(state[5]), u32(state[6]), u32(state[7])
    for n in range(ROUNDS):
        s1 = _rotated(e, 6) ^ _rotated(e, 11) ^ _rotated(e, 25)
        t1 = u32(h + s1 + ((e & f) ^ (~e & g)) + constants[n] + w[n])
        s0 = _rotated(a, 2) ^ _rotated(a, 13) ^ _rotated(a, 22)
        t2 = u32(s0 + ((a & b) ^ (a & c) ^ (b & c)))
        a, b, c, d, e, f, g, h = u32(t1 + t2), a, b, c, u32(d + t1), e, f, g
    for n, word in enumerate((a, b, c, d, e, f, g, h)):
        state[n] += word


@kernel
def _digest(source: k.Octets, at: int, length: int, shared: Shared) -> int:
    """The first 48 bits of SHA-256 over the key, which `message` begins with, and some bytes."""
    message, state = shared.message, shared.sha_state
    size = KEY_LENGTH + length
    end = (size + 9 + BLOCK - 1) // BLOCK * BLOCK  # with one bit and the length
    for n in range(length):
        message[KEY_LENGTH + n] = source[at + n]
    for n in range(size, end):
        message[n] = 0
    message[size] = 0x80
    message[end - 2], message[end - 1] = 8 * size >> 8, 8 * size & 0xFF
    for n in range(STATE):
        state[n] = shared.sha_constants[ROUNDS + n]
    for block in range(0, end, BLOCK):
        _compress(block, shared)
    return i64(state[0]) << 16 | i64(state[1]) >> 16


@kernel
def check_signature(at: int, head: int, stop: int, shared: Shared) -> Any:
    """Whether the frame of `data` that ends at `stop` is sealed, and the cell of its stream if its
    signature is correct and new, else -1."""
    loop, data = shared.loop, shared.data
    if head != 10 or data[at + 2] & SIGNED == 0:
        return False, i64(-1)
    if not loop[k.SIGNING] & k.KEYED:
        return loop[k.SIGNING] == 0, i64(-1)
    sent, place = i64(0), stop - DIGEST_LENGTH
    for n in range(DIGEST_LENGTH):
        sent = sent << 8 | i64(data[place + n])
    if sent != _digest(data, at, place - at, shared):
        return True, i64(-1)
    stream = i64(data[at + 5]) << 16 | i64(data[at + 6]) << 8 | i64(data[place - UNDIGESTED])
    cell = i64(stream_cell(shared.streams, stream))
    if cell < 0 or little_endian(data, place - 6, 6) < shared.streams[cell]:
        return True, i64(-1)
    return False, cell


@kernel
def note_signature(
    at: int, stop: int, extra: int, sealed: bool, cell: int, link: int, shared: Shared
) -> int:
    """Note the signature of a frame that passes, and strip it if that is wanted; its end then."""
    loop, data = shared.loop, shared.data
    if loop[k.SIGNING] == 0 or data[at] != 0xFD or data[at + 2] & SIGNED == 0:
        return stop
    shared.ports[link, k.BAD_SIGNATURES] += sealed
    if cell >= 0:
        shared.streams[cell] = little_endian(data, stop - DIGEST_LENGTH - 6, 6) + 1
    if sealed or not loop[k.SIGNING] & k.STRIPPED:
        return stop
    data[at + 2] &= ~SIGNED & 0xFF
    end, base = stop - SIGNATURE_LENGTH, data.ctypes.data
    checksum = range_crc(base + at + 1, base + end - 2, np.uint64(extra), shared.crc)
    data[end - 2], data[end - 1] = checksum & np.uint64(0xFF), checksum >> np.uint64(8)
    return end


@kernel
def sign_again(item: int, end: int, signature_at: int, shared: Shared) -> None:
    """Put a frame's signature behind its checksum in `work`, which ends at `end`; a changed frame
    gets a new one, with its link id and timestamp."""
    work = shared.work
    for n in range(SIGNATURE_LENGTH):
        work[end + n] = shared.data[signature_at + n]
    if shared.loop[k.SIGNING] & k.KEYED and shared.items[item, k.ALTERED] == k.CHANGED:
        base = item * k.SLOT
        digest = _digest(work, base, end + UNDIGESTED - base, shared)
        for n in range(DIGEST_LENGTH):
            work[end + UNDIGESTED + n] = digest >> (40 - 8 * n) & 0xFF

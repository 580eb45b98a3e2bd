"""The compiled form's signatures: checked, made and stripped as `wire.signing` does.

Both call SHA-256 of OpenSSL; without its functions signed frames are for the core.
"""

from typing import Any

import numpy as np

from mavproxy_fault.compiled import layout as k
from mavproxy_fault.compiled.element_bytes import little_endian
from mavproxy_fault.compiled.kernel import call, i64, kernel, kernel_of
from mavproxy_fault.compiled.layout import Shared
from mavproxy_fault.wire import signing
from mavproxy_fault.wire.frame import SIGNATURE_LENGTH, SIGNED
from mavproxy_fault.wire.framing import range_crc
from mavproxy_fault.wire.signing import DIGEST_LENGTH, KEY_LENGTH

UNDIGESTED = SIGNATURE_LENGTH - DIGEST_LENGTH  # link id and timestamp, which are signed too

next_cell = kernel_of(signing.next_cell)


@kernel
def _digest(place: int, length: int, shared: Shared) -> int:
    """The first 48 bits of SHA-256 over the key and some bytes, in network order."""
    loop, state, digest = shared.loop, shared.sha_state.ctypes.data, shared.digest.ctypes.data
    call(loop[k.SHA_INIT], state, 0, 0)
    call(loop[k.SHA_UPDATE], state, shared.key.ctypes.data, KEY_LENGTH)
    call(loop[k.SHA_UPDATE], state, place, length)
    call(loop[k.SHA_FINAL], digest, state, 0)
    return i64(little_endian(digest, DIGEST_LENGTH))


@kernel
def check_signature(at: int, head: int, stop: int, shared: Shared) -> Any:
    """Whether the frame of `data` that ends at `stop` is sealed, and the cell of its stream if its
    signature is correct and new, else -1."""
    loop, data = shared.loop, shared.data
    if head != 10 or data[at + 2] & SIGNED == 0:
        return False, i64(-1)
    if not loop[k.SIGNING] & k.KEYED:
        return loop[k.SIGNING] == 0, i64(-1)
    base, place = data.ctypes.data, stop - DIGEST_LENGTH
    sent = little_endian(base + place, DIGEST_LENGTH)
    if sent != _digest(base + at, place - at, shared):
        return True, i64(-1)
    sender, stamp = i64(data[at + 5]) << 8 | i64(data[at + 6]), little_endian(base + place - 6, 6)
    cell = i64(next_cell(shared.streams, sender, i64(data[place - UNDIGESTED]), stamp))
    return cell < 0, cell


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
        shared.streams[cell] = little_endian(data.ctypes.data + stop - DIGEST_LENGTH - 6, 6) + 1
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
        _digest(work.ctypes.data + base, end + UNDIGESTED - base, shared)
        for n in range(DIGEST_LENGTH):
            work[end + UNDIGESTED + n] = shared.digest[n]

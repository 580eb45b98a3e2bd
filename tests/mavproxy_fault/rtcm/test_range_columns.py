"""Comparison of the compiled and the interpreted MSM7 reader on random messages."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mavproxy_fault.rtcm.msm7 import decode_msm7
from mavproxy_fault.rtcm.range_columns import NAMES, NO_MSM7, RangeColumns, read_ranges
from mavproxy_fault.rtcm.transport import unwrap_message, wrap_message
from mavproxy_fault.rtcm.tunnel_columns import Messages


@st.composite
def messages(draw) -> bytes:
    """Generate any satellites with any signals and random fields."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    number = draw(st.sampled_from((1077, 1097)))
    satellites = sum(1 << (64 - n) for n in draw(st.sets(st.integers(1, 64), max_size=12)))
    signals = sum(1 << (32 - n) for n in draw(st.sets(st.integers(1, 32), max_size=3)))
    count, cells = satellites.bit_count(), satellites.bit_count() * signals.bit_count()
    mask = int.from_bytes(rng.bytes(8), "big") & ((1 << cells) - 1)
    parts = [
        (number, 12), (0, 12), (draw(st.integers(0, 604_799_999)), 30), (draw(st.booleans()), 1),
        (0, 18), (satellites, 64), (signals, 32), (mask, cells),
    ]  # fmt: skip
    width = 36 * count + 80 * mask.bit_count()
    noise = int.from_bytes(rng.bytes((width + 7) // 8), "big") & ((1 << width) - 1)
    bits = ""
    for value, length in (*parts, (noise, width)):
        bits += f"{int(value):0{length}b}" if length else ""
    bits += "0" * (-len(bits) % 8)
    return wrap_message(int(bits, 2).to_bytes(len(bits) // 8, "big"))


def read(*found: bytes) -> RangeColumns:
    """Decode several consecutive messages."""
    ends = np.cumsum([len(message) for message in found])
    return read_ranges(Messages(np.frombuffer(b"".join(found), np.uint8), ends, 0 * ends))


@given(st.lists(messages(), min_size=1, max_size=3))
def test_the_compiled_reader_gives_the_same_values(found: list[bytes]):
    quick, begin = read(*found), 0
    for i, plain in enumerate(map(decode_msm7, found)):
        rows = slice(begin, quick.ends[i])
        assert (quick.tow_ms[i] / 1000.0, bool(quick.more[i])) == (plain.tow_s, plain.more)
        assert tuple(NAMES[code] for code in quick.code[rows]) == plain.satellites
        for name in ("pseudorange_m", "doppler_mps", "cn0_dbhz"):
            assert np.array_equal(getattr(quick, name)[rows], getattr(plain, name), equal_nan=True)
        begin = quick.ends[i]


@given(messages(), st.data())
def test_a_truncated_message_is_not_an_epoch(message: bytes, data):
    body = unwrap_message(message)
    short = wrap_message(body[: data.draw(st.integers(0, len(body) - 1))])
    found = read(short, message)
    assert found.tow_ms[0] == NO_MSM7
    assert found.ends[0] == 0
    assert found.tow_ms[1] != NO_MSM7

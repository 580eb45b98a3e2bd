"""The compiled reading of MSM7 against the plain one, on messages of random bits."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavproxy_fault.wire.msm7 import decode_msm7
from mavproxy_fault.wire.ranges import read_ranges
from mavproxy_fault.wire.rtcm import unwrap, wrap


@st.composite
def messages(draw) -> bytes:
    """Any satellites with any signals, their fields of random bits."""
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
    return wrap(int(bits, 2).to_bytes(len(bits) // 8, "big"))


@given(messages())
def test_the_compiled_reading_gives_the_same_values(message: bytes):
    plain, quick = decode_msm7(message), read_ranges(message)
    assert (quick.tow_s, quick.satellites, quick.more) == (
        plain.tow_s,
        plain.satellites,
        plain.more,
    )
    for name in ("pseudorange_m", "doppler_mps", "cn0_dbhz"):
        assert np.array_equal(getattr(quick, name), getattr(plain, name), equal_nan=True), name


@given(messages(), st.data())
def test_a_message_that_ends_early_is_no_epoch(message: bytes, data):
    body = unwrap(message)
    short = wrap(body[: data.draw(st.integers(2, len(body) - 1))])
    with pytest.raises(ValueError, match="not a whole MSM7"):
        read_ranges(short)

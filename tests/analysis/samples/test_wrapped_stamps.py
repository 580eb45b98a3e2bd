"""Actuator outputs of a vehicle whose 32-bit microsecond timestamps have wrapped."""

import pytest

from analysis.samples.block import COMMAND
from analysis.samples.decoder import Decoder
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame

ROUND_US = 1 << 32


def frame(name: str, **values: object) -> Frame:
    return Frame(build_frame(message_layout(name), values), message_layout(name))


def outputs(t_us: int) -> Frame:
    return frame("SERVO_OUTPUT_RAW", time_usec=t_us % ROUND_US, servo1_raw=1500)


def attitude(t_us: int) -> Frame:
    return frame("ATTITUDE", time_boot_ms=t_us // 1000)


def stamps(decoder: Decoder, *frames: Frame) -> list[int]:
    block = decoder.decode(frames)
    return block.t_us[block.kind == COMMAND].tolist()


@pytest.mark.parametrize("rounds", [0, 1, 5])
def test_a_timestamp_is_unwrapped_by_the_time_since_boot(rounds: int) -> None:
    at_us = rounds * ROUND_US + 3_000_000
    decoder = Decoder()
    found = stamps(decoder, outputs(at_us), attitude(at_us), outputs(at_us + 50_000))
    assert found == [at_us, at_us + 50_000]
    # A block without boot time continues from the block before.
    assert stamps(decoder, outputs(at_us + 100_000)) == [at_us + 100_000]


def test_a_wrap_is_no_time_jump() -> None:
    """The stamps of outputs and attitude lie on either side of it."""
    end_us = 2 * ROUND_US
    frames = [attitude(end_us - 20_000), outputs(end_us + 10_000), attitude(end_us + 20_000)]
    found = stamps(Decoder(), outputs(end_us - 30_000), *frames, outputs(end_us - 5_000))
    assert found == [end_us - 30_000, end_us + 10_000, end_us - 5_000]


def test_without_a_time_since_boot_timestamps_are_unchanged() -> None:
    assert stamps(Decoder(), outputs(ROUND_US + 7)) == [7]

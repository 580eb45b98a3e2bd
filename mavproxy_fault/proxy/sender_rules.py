"""What follows from who sent a frame and when: its time, what is missing before it, where it goes.

Each rule stands here once and works on the flat array of `senders`. The core calls it as it is,
`compiled` as machine code; so the functions use numbers and arrays only, and none calls another.
"""

from collections.abc import MutableSequence, Sequence

from mavproxy_fault.proxy.senders import (
    CANDIDATE_STAMP,
    CLOCK_OFFSET,
    GAPS,
    LAST_HEARD,
    LINKS,
    NEWEST_STAMP,
    NEWEST_TIME,
    NEXT_SEQ,
    SYSTEM_LINKS,
    SYSTEM_TIME,
    T0,
    UNCONFIRMED,
    UNKNOWN,
)

UNIX_TIME_FROM_US = 10**15  # stamps beyond are Unix time (2001 on); no vehicle is up for 31 years
MAX_STAMP_US = 1 << 53  # no stamp reaches the year 2255: such a number is damage, and read as none
MAX_TIME_JUMP_US = 10_000_000

Senders = MutableSequence[int]


def vehicle_time(senders: Senders, sender: int, stamp_us: int, now_us: int) -> int:
    """The time of a frame that came at `now_us` of the wall clock, in microseconds.

    A frame without a stamp (0) takes the newest time of its system, else of any; before the first
    stamp the wall clock serves. A stamp that leaps by more than ten seconds, and further than the
    wall clock did, is doubted and counted, and its frame takes the newest time, until the next
    stamp of that clock bears it out.

    Parameters
    ----------
    senders : sequence of int, shape (senders.SIZE,)
        What is known of all senders; brought up to date.
    sender : int
        `system << 8 | component`.
    stamp_us, now_us : int
        The frame's stamp, and the wall clock.
    """
    newest_at = SYSTEM_TIME + (sender >> 8)
    if stamp_us == 0:
        if senders[newest_at] != UNKNOWN:
            return senders[newest_at]
        return now_us if senders[T0] == UNKNOWN else senders[NEWEST_TIME]
    clock = sender << 1 | (1 if stamp_us >= UNIX_TIME_FROM_US else 0)
    shift = senders[CLOCK_OFFSET + clock]
    if shift == UNKNOWN:
        if senders[T0] == UNKNOWN:
            senders[T0] = stamp_us
            senders[NEWEST_TIME] = stamp_us
        ahead_us = stamp_us - senders[NEWEST_TIME]
        shift = 0 if abs(ahead_us) <= MAX_TIME_JUMP_US else -ahead_us
        senders[CLOCK_OFFSET + clock] = shift
    else:
        leap_us = stamp_us - senders[NEWEST_STAMP + clock]
        if leap_us < -MAX_TIME_JUMP_US or (
            leap_us > MAX_TIME_JUMP_US
            and leap_us > now_us - senders[LAST_HEARD + clock] + MAX_TIME_JUMP_US
        ):
            suspect = senders[CANDIDATE_STAMP + clock]
            senders[CANDIDATE_STAMP + clock] = stamp_us
            same_way = (suspect > senders[NEWEST_STAMP + clock]) == (leap_us > 0)
            if suspect == 0 or not same_way or stamp_us < suspect - MAX_TIME_JUMP_US:
                senders[UNCONFIRMED] += 1
                return senders[newest_at]
            if leap_us < 0:  # the vehicle has started again: its time goes on from the newest
                shift = senders[NEWEST_TIME] - min(suspect, stamp_us)
                senders[CLOCK_OFFSET + clock] = shift
    t_us = stamp_us + shift
    senders[NEWEST_STAMP + clock] = stamp_us
    senders[LAST_HEARD + clock] = now_us
    senders[CANDIDATE_STAMP + clock] = 0
    senders[NEWEST_TIME] = t_us
    senders[newest_at] = t_us
    return t_us


def missing_before(senders: Senders, sender: int, seq: int) -> int:
    """How many frames of a sender are missing before the one numbered `seq`; counted there too."""
    expected = senders[NEXT_SEQ + sender]
    senders[NEXT_SEQ + sender] = (seq + 1) & 0xFF
    if expected == UNKNOWN or seq == expected:
        return 0
    missing = (seq - expected) & 0xFF
    senders[GAPS + sender] += missing
    return missing


def read_target(data: Sequence[int], payload: int, length: int, places: tuple[int, int]) -> int:
    """`system << 8 | component` that a frame is for, 0 for all; cut zeros read as 0.

    `payload` is where the payload of `length` bytes begins in `data`, `places` are the offsets of
    the target system and component in it, -1 without one.
    """
    system_at, component_at = places
    if system_at < 0 or system_at >= length:
        return 0
    system = data[payload + system_at] << 8
    if system == 0 or component_at < 0 or component_at >= length:
        return system
    return system | data[payload + component_at]


def select_links(senders: Senders, addressee: int, elsewhere: int) -> int:
    """The links a frame goes to, of those that it did not come from (bit masks).

    One component's frame goes where that component was heard, else where its system was, else to
    all: nothing is lost because its addressee has not spoken yet.
    """
    if addressee == 0:
        return elsewhere
    exact = senders[LINKS + addressee]
    if exact != 0:
        return exact & elsewhere
    found = senders[SYSTEM_LINKS + (addressee >> 8)] & elsewhere
    return found if found != 0 else elsewhere

"""Rules by sender and arrival time: a frame's vehicle and link time, sequence gaps and routing.

Each rule is defined once, on the flat array of `senders`. The core calls it directly, `compiled`
compiles it with those that it calls; so the functions use only numbers and arrays.
"""

from collections.abc import MutableSequence, Sequence

from mavproxy_fault.proxy.senders import (
    CANDIDATE_STAMP,
    CLOCK_OFFSET,
    GAPS,
    LAST_HEARD,
    LINK_CLOCK,
    LINK_STAMP,
    LINK_STAMP_HEARD,
    LINK_TIME,
    LINKS,
    NEWEST_STAMP,
    NEWEST_TIME,
    NEXT_SEQ,
    SIMULATED,
    SYSTEM_LINKS,
    SYSTEM_TIME,
    T0,
    UNCONFIRMED,
    UNKNOWN,
)

UNIX_TIME_FROM_US = 10**15  # larger: Unix time (from 2001); no vehicle runs for 31 years
MAX_STAMP_US = 1 << 53  # larger timestamps (year 2255) are corrupted and ignored
SAMPLE_PERIOD_US = 20_000  # 50 Hz of the vehicle's time are sampled for viewers: enough for a plot
MAX_TIME_JUMP_US = 10_000_000  # chosen: far above link delays; more is a reboot or an error

Senders = MutableSequence[int]


def vehicle_time(senders: Senders, sender: int, stamp_us: int, now_us: int) -> int:
    """Return the vehicle time in microseconds of a frame received at wall time `now_us`.

    A frame without a timestamp (0) gets the newest time of its system, or of any system if its own
    has none of the last ten seconds; before the first timestamp, wall time. A timestamp that jumps
    by more than ten seconds, and further than the wall clock, is unconfirmed and counted: its frame
    gets the newest time, until the next timestamp of that clock confirms the jump. A `sender` is
    `system << 8 | component`.
    """
    newest_at = SYSTEM_TIME + (sender >> 8)
    if stamp_us == 0:
        if senders[T0] == UNKNOWN:
            return now_us
        own_us, newest_us = senders[newest_at], senders[NEWEST_TIME]
        # A ground station may stamp a single frame, at its start.
        recent = own_us != UNKNOWN and newest_us - own_us <= MAX_TIME_JUMP_US
        return own_us if recent else newest_us
    clock = sender << 1 | (1 if stamp_us >= UNIX_TIME_FROM_US else 0)
    shift = senders[CLOCK_OFFSET + clock]
    if shift == UNKNOWN:
        if senders[T0] == UNKNOWN:
            senders[T0] = stamp_us
            senders[NEWEST_TIME] = stamp_us
            senders[LINK_TIME] = stamp_us
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
            if leap_us < 0:  # reboot: its time continues from the newest
                shift = senders[NEWEST_TIME] - min(suspect, stamp_us)
                if abs(shift) <= MAX_TIME_JUMP_US:  # it counts as the timeline does from now on
                    shift = 0
                senders[CLOCK_OFFSET + clock] = shift
    t_us = stamp_us + shift
    senders[NEWEST_STAMP + clock] = stamp_us
    senders[LAST_HEARD + clock] = now_us
    senders[CANDIDATE_STAMP + clock] = 0
    senders[NEWEST_TIME] = t_us
    senders[newest_at] = t_us
    follow_link(senders, clock, t_us, now_us)
    return t_us


def read_stamp(data: Sequence[int], payload: int, length: int, place: tuple[int, int, int]) -> int:
    """Return a frame's timestamp in microseconds; 0 if it is missing or impossible.

    The payload of `length` bytes starts at offset `payload` of `data`; `place` is the timestamp's
    offset in it (-1 for none), its size, and microseconds per count.
    """
    at, size, scale = place
    if at < 0:
        return 0
    count = 0
    for n in range(min(size, length - at)):
        count |= data[payload + at + n] << (8 * n)
    # Eight bytes may make a negative number here, or one that is too large to be scaled.
    stamp_us = count * scale if 0 <= count < MAX_STAMP_US else 0
    return stamp_us if stamp_us < MAX_STAMP_US else 0


def is_selected(
    where: tuple[int, int, int, int], sender: int, from_vehicle: int, instance: int
) -> bool:
    """Return whether an entry's `where` selects a frame.

    It is system, component, direction (1: from the vehicle) and instance, -1 for any.
    """
    system, component, way, number = where
    return (
        (system < 0 or system == sender >> 8)
        and (component < 0 or component == sender & 0xFF)
        and (way < 0 or way == from_vehicle)
        and (number < 0 or number == instance)
    )


def follow_link(senders: Senders, clock: int, t_us: int, now_us: int) -> None:
    """Note the newest time of a clock for the link time, which follows the clock that is ahead."""
    ahead = t_us > senders[LINK_STAMP] + now_us - senders[LINK_STAMP_HEARD]
    if ahead or clock == senders[LINK_CLOCK]:
        senders[LINK_CLOCK] = clock
        senders[LINK_STAMP] = t_us
        senders[LINK_STAMP_HEARD] = now_us


def link_time(senders: Senders, now_us: int) -> int:
    """Return the link time at wall time `now_us`: the newest timestamp and the wall time since.

    It never decreases. A simulator's lockstep stops the clock of its link, so there it is the
    vehicle time; before the first timestamp it is wall time.
    """
    if senders[T0] == UNKNOWN:
        return now_us
    if senders[SIMULATED]:
        return senders[NEWEST_TIME]
    return max(senders[LINK_TIME], senders[LINK_STAMP] + now_us - senders[LINK_STAMP_HEARD])


def missing_before(senders: Senders, sender: int, seq: int) -> int:
    """Return the number of frames missing before `seq`, and add it to the sender's gaps."""
    expected = senders[NEXT_SEQ + sender]
    senders[NEXT_SEQ + sender] = (seq + 1) & 0xFF
    if expected == UNKNOWN or seq == expected:
        return 0
    missing = (seq - expected) & 0xFF
    senders[GAPS + sender] += missing
    return missing


def read_target(data: Sequence[int], payload: int, length: int, places: tuple[int, int]) -> int:
    """Return a frame's target as `system << 8 | component`, 0 for all; truncated bytes read as 0.

    The payload of `length` bytes starts at offset `payload` of `data`; `places` are the offsets of
    target system and component in it, -1 if the message has none.
    """
    system_at, component_at = places
    if system_at < 0 or system_at >= length:
        return 0
    system = data[payload + system_at] << 8
    if system == 0 or component_at < 0 or component_at >= length:
        return system
    return system | data[payload + component_at]


def select_links(senders: Senders, addressee: int, elsewhere: int) -> int:
    """Select the links for a frame from `elsewhere`, all links but its own (bit masks).

    A frame for one component goes where that component was heard, else where its system was heard,
    else to all links, so that a target not heard yet still receives it.
    """
    if addressee == 0:
        return elsewhere
    exact = senders[LINKS + addressee]
    if exact != 0:
        return exact & elsewhere
    links = senders[SYSTEM_LINKS + (addressee >> 8)] & elsewhere
    return links if links != 0 else elsewhere

"""GPS time of calendar dates in the time systems of RINEX files.

GLONASS and UTC have leap seconds, BeiDou time is 14 s behind GPS time, the others agree with it
[1]_.

References
----------
.. [1] IGS/RTCM, RINEX 4.01, section 4.1.
"""

from collections.abc import Sequence
from datetime import date, datetime

WEEK_S = 604_800.0
BEIDOU_OFFSET_S = 14.0  # GPS time minus BeiDou time
GPS_DAY_ZERO = date(1980, 1, 6).toordinal()
CENTURY_2 = 80  # two-digit years from here on are in the twentieth century


def leap_seconds(day: date) -> int:
    """GPS time minus UTC on a day, in s."""
    from pynmeagps import leapsecond  # not every command needs it

    return int(leapsecond(datetime(day.year, day.month, day.day)))


def gps_time(
    year: int, month: int, day: int, seconds_of_day: float, clock: str = "GPS"
) -> tuple[int, float]:
    """GPS week and seconds of week of a calendar date in a time system, `GPS`, `GLO`, `BDT`, ..."""
    today = date(year, month, day)
    if clock in ("GLO", "UTC"):
        seconds_of_day += leap_seconds(today)
    elif clock in ("BDT", "BDS"):
        seconds_of_day += BEIDOU_OFFSET_S
    week, days = divmod(today.toordinal() - GPS_DAY_ZERO, 7)
    return normalized(week, days * 86_400.0 + seconds_of_day)


def normalized(week: int, tow_s: float) -> tuple[int, float]:
    """The time as week and seconds from 0 to less than a week."""
    weeks, tow_s = divmod(tow_s, WEEK_S)
    return week + int(weeks), tow_s


def time_of_words(words: Sequence[str], clock: str) -> tuple[int, float]:
    """GPS week and seconds of week of year, month, day, hour, minute and second in a file.

    Raises
    ------
    ValueError
        If they are not six numbers of a date.
    """
    year, month, day, hour, minute = (int(word) for word in words[:5])
    second = float(*words[5:])
    if hour > 23 or minute > 59 or not 0.0 <= second < 61.0:  # 60 in a leap second
        raise ValueError(f"{' '.join(words)} is no time of day")
    if year < 100:
        year += 1900 if year >= CENTURY_2 else 2000
    return gps_time(year, month, day, hour * 3600 + minute * 60 + second, clock)

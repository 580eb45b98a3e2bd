import math

import pytest

from mavproxy_fault.documents.errors import ConfigError
from simvehicle.app.pace import Pace, parse_speed


@pytest.mark.parametrize(
    ("text", "speed"), [("1", 1.0), ("0.5", 0.5), ("40", 40), ("max", math.inf)]
)
def test_speeds_are_numbers_or_max(text: str, speed: float) -> None:
    assert parse_speed(text) == speed


@pytest.mark.parametrize("text", ["fast", "0", "-1", "nan", "inf", ""])
def test_an_invalid_speed_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="--speed"):
        parse_speed(text)


def test_at_twice_real_time_a_second_takes_half() -> None:
    pace = Pace(2.0)
    assert pace.wait_s(0, 100.0) == 0.0
    assert pace.wait_s(1_000_000, 100.2) == pytest.approx(0.3)
    assert pace.wait_s(1_000_000, 100.5) == 0.0


def test_as_fast_as_possible_never_waits() -> None:
    pace = Pace(math.inf)
    assert pace.wait_s(0, 0.0) == 0.0
    assert pace.wait_s(10_000_000, 0.0) == 0.0


def test_after_a_long_pause_it_continues_at_its_pace() -> None:
    pace = Pace(1.0)
    pace.wait_s(0, 0.0)
    assert pace.wait_s(1_000_000, 60.0) == 0.0  # the pause
    assert pace.wait_s(2_000_000, 60.0) == pytest.approx(1.0)

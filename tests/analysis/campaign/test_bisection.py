import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from analysis.campaign.bisection import CriticalMagnitude, bisect_magnitude
from analysis.campaign.campaign_file import Magnitudes


def search_result(interval: Magnitudes, threshold: float) -> CriticalMagnitude:
    """Run the bisection for a subject that breaks at a threshold."""
    search = bisect_magnitude(interval)
    magnitude = next(search)
    try:
        while True:
            magnitude = search.send(magnitude >= threshold)
    except StopIteration as over:
        return over.value


@given(st.floats(0.01, 100.0))
def test_eight_flights_bracket_any_threshold(threshold: float) -> None:
    critical = search_result(Magnitudes(low=0.01, high=100.0), threshold)
    assert critical.flights <= 8
    assert critical.magnitude is not None
    assert critical.magnitude >= threshold * (1 - 1e-9)
    if critical.harmless is not None:
        assert critical.harmless < threshold
        step = math.log(critical.magnitude / critical.harmless)
        assert step == pytest.approx(math.log(1e4) / 64)


def test_an_interval_that_is_harmless_or_worse_throughout_takes_one_or_two_flights() -> None:
    interval = Magnitudes(low=1.0, high=2.0, spacing="linear")
    assert search_result(interval, 3.0) == CriticalMagnitude(None, 2.0, 1)
    assert search_result(interval, 0.5) == CriticalMagnitude(1.0, None, 2)


def test_a_linear_interval_may_be_negative() -> None:
    critical = search_result(Magnitudes(low=-1.0, high=1.0, spacing="linear"), 0.0)
    assert critical.magnitude == pytest.approx(0.0, abs=1e-9)
    assert critical.harmless == pytest.approx(-1 / 32)

"""Numbers survive their packing, long curves keep their peaks, gaps stay gaps."""

import base64
import zlib

import numpy as np

from analysis.report.curves.recording import FlightData, Span
from analysis.report.page.packed_numbers import (
    MAX_CURVE_SAMPLES,
    MOST_SPANS,
    PackedNumbers,
    break_at_gaps,
    break_at_wraps,
    longest_curve,
    thin_curve,
    thin_spans,
)
from analysis.report.page.page_file import page_html
from analysis.report.page.page_parts import ReportPage
from analysis.report.page.series_colours import PALETTE, series_colours


def unpacked(numbers: PackedNumbers) -> np.typing.NDArray[np.float32]:
    planes = np.frombuffer(zlib.decompress(base64.b64decode(numbers.text())), np.uint8)
    return np.ascontiguousarray(planes.reshape(4, -1).T).view("<f4")[:, 0]


def test_packed_values_are_found_at_their_place() -> None:
    numbers = PackedNumbers()
    numbers.add_values(np.array([1.0, 2.0]))
    place = numbers.add_values(np.array([3.5, np.nan]))
    assert place == {"at": 2, "n": 2}
    assert unpacked(numbers)[2] == 3.5
    assert np.isnan(unpacked(numbers)[3])


def test_an_even_time_axis_is_two_numbers() -> None:
    numbers = PackedNumbers()
    place = numbers.add_times(1000.0 + 0.004 * np.arange(50_000))
    assert set(place) == {"offset", "step", "n"}
    assert numbers.parts == []


def test_an_uneven_time_axis_keeps_microseconds_an_hour_into_a_log() -> None:
    rng = np.random.default_rng(1)
    t_s = 3600 + np.cumsum(rng.uniform(0.003, 0.005, 10_000))
    numbers = PackedNumbers()
    place = numbers.add_times(t_s)
    at = int(place["at"])
    back = place["offset"] + place["step"] * np.arange(10_000) + unpacked(numbers)[at : at + 10_000]
    assert np.abs(back - t_s).max() < 2e-6


def test_a_thinned_curve_keeps_its_ends_and_its_single_spike() -> None:
    t_s = np.arange(500_000) * 0.001
    value = np.sin(t_s)
    value[123_456] = 99.0
    thin_t_s, thin = thin_curve(t_s, value, 10_000)
    assert len(thin) <= 10_002
    assert thin.max() == 99.0
    assert thin_t_s[thin.argmax()] == t_s[123_456]
    assert (thin_t_s[0], thin_t_s[-1]) == (t_s[0], t_s[-1])


def test_a_pause_breaks_the_curve_and_jitter_does_not() -> None:
    t_s = np.array([0.0, 0.1, 0.2, 0.25, 0.4, 9.0, 9.1])
    broken_t_s, value = break_at_gaps(t_s, np.ones(7))
    assert broken_t_s.tolist() == [0.0, 0.1, 0.2, 0.25, 0.4, 4.7, 9.0, 9.1]
    assert np.flatnonzero(np.isnan(value)).tolist() == [5]


def test_a_heading_that_wraps_has_a_gap_and_no_line_across() -> None:
    t_s, angle = break_at_wraps(np.array([0.0, 1, 2]), np.array([170.0, 179, -179]))
    assert t_s.tolist() == [0, 1, 1.5, 2]
    assert np.isnan(angle[2])
    assert angle[3] == -179


def test_curves_share_the_size_of_a_page_and_short_ones_stay_complete() -> None:
    assert longest_curve([10, 20, 30], most=100) == MAX_CURVE_SAMPLES
    longest = longest_curve([10, 1000, 2000], most=110)
    assert longest == 50
    assert 10 + 2 * longest == 110


def test_a_quantity_has_the_same_colour_on_every_plot() -> None:
    assert series_colours(["estimate", "desired"])[1] == series_colours(["actual", "desired"])[1]
    together = series_colours(["ATTITUDE", "ATTITUDE_QUATERNION", "desired", "gate x"])
    assert len(set(together)) == 4
    assert len(PALETTE) == 12
    assert len(set(series_colours([f"G{i:02}" for i in range(11)]))) == 11


def test_a_timeline_of_thousands_of_flights_stays_small() -> None:
    flights = range(22_600)
    armed = [Span("armed", 60.0 * i, 60.0 * i + 40, "armed", "mode") for i in flights]
    armed += [Span("armed", 60.0 * i + 40, 60.0 * i + 60, "disarmed", "mode") for i in flights]
    rare = Span("estimator in use", 5e5, 5e5 + 0.1, "core 2", "mode")
    found = thin_spans([*armed, rare])
    assert len(found) <= 2 * MOST_SPANS + 1
    # Nothing is lost: what is merged still covers the flights.
    assert rare in found
    merged = [span for span in found if span.text == "armed"]
    assert all(any(s.start_s <= 60.0 * i < s.end_s for s in merged) for i in (0, 11_000, 22_599))
    page = page_html(ReportPage("x", "PASS", [], []), FlightData("x", spans=armed))
    assert len(page) < 1_000_000


def test_a_timeline_of_a_few_flights_is_complete() -> None:
    spans = [Span("armed", 60.0 * i, 60.0 * i + 40, "armed", "mode") for i in range(MOST_SPANS)]
    assert thin_spans(spans) == spans

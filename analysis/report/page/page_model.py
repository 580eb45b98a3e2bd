"""Build the data model of the page's scripts: panels, spans, events, tracks, spectra."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from analysis.report.curves.panels import BY_KEY, PANELS
from analysis.report.curves.recording import FlightData, GroundTrack, Signal, Vector, inside_windows
from analysis.report.curves.spectra import (
    Spectrogram,
    SpectrumPanel,
    frequency_marks,
    spectrum_panels,
)
from analysis.report.curves.vehicle_phase import armed_windows
from analysis.report.page.packed_numbers import (
    PackedNumbers,
    break_at_gaps,
    break_at_wraps,
    longest_curve,
    thin_curve,
    thin_spans,
)
from analysis.report.page.page_parts import ReportPage
from analysis.report.page.series_colours import series_colours
from analysis.report.page.uncertainty import track_sigma

# Angles whose curves are broken where they wrap.
HEADINGS = {"yaw", "error-yaw", "instance-yaw"}
MARGIN_S = 2.0  # of a track shown before arming and after disarming
MARKS_SHOWN, TRACK_POINTS = 1000, 20_000
LEVELS, RANGE_DB = 255, 60.0  # of a spectrogram

Model = dict[str, Any]


def page_model(page: ReportPage, recording: FlightData, numbers: PackedNumbers) -> Model:
    """Build the model of a page; adds its numbers to `numbers`."""
    # The axis covers spans too: an injected fault may outlast the data.
    starts = [signal.t_s[0] for signal in recording.signals] + [s.start_s for s in recording.spans]
    ends = [signal.t_s[-1] for signal in recording.signals] + [s.end_s for s in recording.spans]
    start = float(min(starts, default=0.0))
    tracks = tracks_in_flight(recording)
    spectra = spectrum_panels(recording, longest_armed(recording))
    return {
        "start": start,
        # An axis needs a length.
        "end": max(float(max(ends, default=1.0)), start + 1e-3),
        "t0_us": recording.t0_us,
        "utc0_us": recording.utc0_us,
        "panels": _panels(page, recording, numbers),
        "spans": [
            {"lane": s.lane, "start": s.start_s, "end": s.end_s, "text": s.text, "kind": s.kind}
            for s in sorted(thin_spans(recording.spans), key=lambda span: _lane_rank(span.lane))
        ],
        "marks": [event._asdict() for event in recording.events[:MARKS_SHOWN]],
        "tracks": _tracks(tracks, recording, numbers),
        # Tracks are in metres from this point.
        "origin": _origin(tracks),
        "spectra": [_spectrum(panel, numbers) for panel in spectra],
        "frequencies": frequency_marks(recording),
    }  # fmt: skip


def _panels(page: ReportPage, recording: FlightData, numbers: PackedNumbers) -> list[Model]:
    shown = {panel.key: recording.of(panel.key) for panel in PANELS}
    # A panel with fewer curves than `least` has nothing to compare.
    shown = {key: signals for key, signals in shown.items() if len(signals) >= BY_KEY[key].least}
    longest = longest_curve([len(s.t_s) for signals in shown.values() for s in signals])
    return [_panel(key, signals, page, numbers, longest) for key, signals in shown.items()]


def _panel(
    key: str, signals: Sequence[Signal], page: ReportPage, numbers: PackedNumbers, longest: int
) -> Model:
    panel = BY_KEY[key]
    colours = series_colours([signal.name for signal in signals])
    series = []
    for signal, colour in zip(signals, colours, strict=True):
        t_s, value = thin_curve(*break_at_gaps(signal.t_s, signal.value), longest)
        if key in HEADINGS:
            # After thinning, which keeps the extremes on both sides of a wrap.
            t_s, value = break_at_wraps(t_s, value)
        places = {"t": numbers.add_times(t_s), "y": numbers.add_values(value)}
        series.append({"name": signal.name, "colour": colour, **places})
    limits = [asdict(limit) for limit in page.limits.get(key, ())]
    head = {"key": key, "title": panel.title, "unit": panel.unit, "log": panel.log}
    return {**head, "series": series, "limits": limits}


def _lane_rank(lane: str) -> int:
    """Sort key of lanes: injected faults, detections, flags, modes."""
    order = ("injected", "detected", "excluded", "found", "estimator", "mode", "armed")
    return next((i for i, word in enumerate(order) if lane.startswith(word)), len(order))


def longest_armed(recording: FlightData) -> tuple[float, float] | None:
    """The longest armed window, for spectra: on the ground the motors are off."""
    armed = armed_windows(recording)
    return max(armed, key=lambda window: window[1] - window[0]) if armed else None


def tracks_in_flight(recording: FlightData) -> list[GroundTrack]:
    """Tracks while armed, if the log has the arming state: before, positions may be invalid.

    Tracks in a local frame are dropped if there are tracks with geographic positions.
    """
    placed = [track for track in recording.tracks if track.on_earth] or recording.tracks
    armed = armed_windows(recording)
    if not armed:
        return placed
    found = []
    for track in placed:
        # With a margin, so that take-off is shown if arming was logged late.
        shown = [(start - MARGIN_S, end + MARGIN_S) for start, end in armed]
        inside = inside_windows(track.t_s, shown)
        if inside.sum() > 1:
            found.append(track.select(inside))
    return found


def _origin(tracks: Sequence[GroundTrack]) -> list[float] | None:
    if not tracks or not tracks[0].on_earth:
        return None
    return [float(tracks[0].lat_deg[0]), float(tracks[0].lon_deg[0])]


def _tracks(
    tracks: Sequence[GroundTrack], recording: FlightData, numbers: PackedNumbers
) -> list[Model]:
    """Tracks in metres east and north of the first track's first point, and altitude."""
    if not tracks:
        return []
    lat0, lon0 = float(tracks[0].lat_deg[0]), float(tracks[0].lon_deg[0])
    colours = series_colours([track.name for track in tracks])
    found = []
    for track, colour in zip(tracks, colours, strict=True):
        north, east = track.metres_from(lat0, lon0)
        step = max(1, len(track.t_s) // TRACK_POINTS)
        axes: list[tuple[str, Vector]] = [("e", east), ("n", north), ("u", track.alt_m)]
        if (sigma := track_sigma(track, recording)) is not None:
            axes += zip(("sn", "se"), sigma, strict=True)
        places: Model = {
            "name": track.name,
            "colour": colour,
            "t": numbers.add_times(track.t_s[::step]),
        }
        for name, values in axes:
            places[name] = numbers.add_values(values[::step])
        found.append(places)
    return found


def _spectrum(panel: SpectrumPanel, numbers: PackedNumbers) -> Model:
    names = [spectrum.name for spectrum in panel.spectra]
    return {
        "key": panel.key,
        "title": panel.title,
        # A dimensionless signal has no unit to square.
        "unit": f"({panel.unit})²/Hz" if panel.unit != "1" else "1/Hz",
        "series": [
            {
                "name": spectrum.name,
                "colour": colour,
                "t": numbers.add_times(spectrum.frequency_hz),
                "y": numbers.add_values(spectrum.density),
            }
            for spectrum, colour in zip(panel.spectra, series_colours(names), strict=True)
        ],
        "images": [_image(image, numbers) for image in panel.images],
    }


def _image(image: Spectrogram, numbers: PackedNumbers) -> Model:
    """The top 60 dB as levels from 0 to 255, the lowest frequency first; -1: no data."""
    # Relative to its own maximum, so that low-noise vehicles show structure too.
    highest = float(np.nanmax(image.level_db))
    lowest = highest - RANGE_DB
    level = np.clip((image.level_db - lowest) / RANGE_DB, 0, 1) * LEVELS
    rounded = np.where(np.isfinite(level), np.round(level), -1)
    return {
        "title": f"by {image.axis}", "axis": image.axis, "start": image.start, "end": image.end,
        "hz": image.highest_hz, "rows": len(level), "low": lowest, "high": highest,
        "y": numbers.add_values(rounded.ravel()),
    }  # fmt: skip

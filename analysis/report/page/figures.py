"""Export every plot of a report as PNG, SVG and PDF with matplotlib, for papers and slides."""

from pathlib import Path
from typing import Any

import numpy as np

from analysis.report.curves.panels import PANELS, Panel
from analysis.report.curves.recording import FlightData
from analysis.report.curves.spectra import SpectrumPanel, frequency_marks, spectrum_panels
from analysis.report.page.packed_numbers import thin_curve
from analysis.report.page.page_model import longest_armed, tracks_in_flight
from analysis.report.page.series_colours import GATES, PALETTE, series_colours
from mavproxy_fault.documents.extras import import_extra

MOST_POINTS = 20_000  # per curve; an SVG with more opens slowly
# Font type 42 embeds TrueType fonts, which journals require; matplotlib's default is type 3.
STYLE = {
    "font.size": 9, "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True,
    "grid.alpha": 0.3, "lines.linewidth": 0.9, "legend.frameon": False, "legend.fontsize": 8,
    "axes.titlesize": 10, "axes.titlelocation": "left", "pdf.fonttype": 42,
}  # fmt: skip
FORMS = ("png", "svg", "pdf")
SHADES = {"injected": ("#d65c1c", 0.16), "flag": ("#c2231c", 0.10)}


def write_figures(folder: Path, recording: FlightData) -> list[Path]:
    """Write each plot in each format to `folder`; returns the files written."""
    mpl = import_extra("matplotlib")
    # No display needed: figures are written on servers too.
    mpl.use("Agg")
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    # Matplotlib uses random ids in SVG; a fixed salt makes the file reproducible.
    with mpl.rc_context({"svg.hashsalt": recording.name, **STYLE}):
        for panel in PANELS:
            if len(recording.of(panel.key)) >= panel.least:
                written += _figure(folder, panel, recording)
        for spectra in spectrum_panels(recording, longest_armed(recording)):
            written += _spectrum(folder, spectra, recording)
        if recording.tracks:
            written += _map(folder, recording)
    return written


def new_figure(width_in: float, height_in: float, **axes: Any) -> tuple[Any, Any]:
    """A figure and its axes."""
    # `Figure` without pyplot, which would keep every figure until it is closed.
    figure = import_extra("matplotlib.figure").Figure(
        figsize=(width_in, height_in), layout="constrained"
    )
    return figure, figure.add_subplot(**axes)


def _figure(folder: Path, panel: Panel, recording: FlightData) -> list[Path]:
    figure, axes = new_figure(8, 3)
    signals = recording.of(panel.key)
    colours = series_colours([signal.name for signal in signals])
    for signal, colour in zip(signals, colours, strict=True):
        t_s, value = thin_curve(signal.t_s, signal.value, MOST_POINTS)
        dashes = "--" if signal.name.startswith(GATES) else "-"
        axes.plot(t_s, value, dashes, color=PALETTE[colour], label=signal.name)
    for span in recording.spans:
        if span.kind in SHADES:
            colour_of, alpha = SHADES[span.kind]
            # lw=0: else the edge would hide a short span.
            axes.axvspan(span.start_s, span.end_s, color=colour_of, alpha=alpha, lw=0)
    # Matplotlib needs a positive value on a logarithmic axis.
    if panel.log and any((signal.value > 0).any() for signal in signals):
        axes.set_yscale("log")
    axes.set(xlabel="t, s", ylabel=panel.unit, title=panel.title)
    axes.legend(ncols=4, loc="best")
    return _saved(figure, folder / panel.key)


def _spectrum(folder: Path, panel: SpectrumPanel, recording: FlightData) -> list[Path]:
    figure, axes = new_figure(8, 3)
    colours = series_colours([spectrum.name for spectrum in panel.spectra])
    for spectrum, colour in zip(panel.spectra, colours, strict=True):
        label, line = spectrum.name, PALETTE[colour]
        axes.semilogy(spectrum.frequency_hz, spectrum.density, color=line, label=label)
    highest_hz = max(float(spectrum.frequency_hz[-1]) for spectrum in panel.spectra)
    for frequency_hz, text in frequency_marks(recording):
        # Marks beyond the spectrum would extend the axis.
        if frequency_hz <= highest_hz:
            axes.axvline(frequency_hz, color="0.3", ls="--", lw=0.8)
            axes.annotate(
                text, (frequency_hz, 0.98), xycoords=("data", "axes fraction"), rotation=90,
                ha="right", va="top", fontsize=7,
            )  # fmt: skip
    axes.set(xlabel="f, Hz", ylabel=f"({panel.unit})²/Hz", title=panel.title)
    axes.legend(ncols=4, loc="best")
    return _saved(figure, folder / panel.key)


def _map(folder: Path, recording: FlightData) -> list[Path]:
    figure, axes = new_figure(6, 6)
    tracks = tracks_in_flight(recording)
    colours = series_colours([track.name for track in tracks])
    for track, colour in zip(tracks, colours, strict=True):
        axes.plot(
            np.unwrap(track.lon_deg, period=360),
            track.lat_deg,
            color=PALETTE[colour],
            label=track.name,
        )
    if tracks:
        # A degree of longitude is shorter by cos(latitude); equal scales keep shapes.
        axes.set_aspect(1 / np.cos(np.radians(float(tracks[0].lat_deg[0]))), "datalim")
    axes.set(xlabel="longitude, deg", ylabel="latitude, deg", title="Tracks")
    axes.legend()
    return _saved(figure, folder / "map")


def _saved(figure: Any, stem: Path) -> list[Path]:
    paths = [stem.with_suffix(f".{form}") for form in FORMS]
    for path in paths:
        figure.savefig(path, dpi=130)
    return paths

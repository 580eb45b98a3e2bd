"""Every plot of a report as PNG and SVG, for papers and slides (matplotlib)."""

from pathlib import Path

from analysis.report.page.pack import thinned
from analysis.report.page.panels import PANELS, Panel
from analysis.report.recordings.recording import Recording

MOST_POINTS = 20_000  # of a curve; an SVG with more opens slowly


def write_figures(folder: Path, recording: Recording) -> list[Path]:
    """Write one PNG and one SVG per plot into `folder`; the files written."""
    import matplotlib as mpl

    mpl.use("Agg")
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    with mpl.rc_context({"svg.hashsalt": recording.name, "font.size": 9}):
        for panel in PANELS:
            if recording.of(panel.key):
                written += _figure(folder, panel, recording)
        if recording.tracks:
            written += _map(folder, recording)
    return written


def _figure(folder: Path, panel: Panel, recording: Recording) -> list[Path]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 3), layout="constrained")
    axes = figure.add_subplot()
    for signal in recording.of(panel.key):
        t_s, value = thinned(signal.t_s, signal.value, MOST_POINTS)
        axes.plot(t_s, value, lw=0.8, label=signal.name)
    for span in recording.spans:
        if span.kind == "injected":
            axes.axvspan(span.start_s, span.end_s, color="tab:orange", alpha=0.15, lw=0)
    axes.set(xlabel="t, s", ylabel=panel.unit, title=panel.title)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8, ncols=4, loc="best")
    return _saved(figure, folder / panel.key)


def _map(folder: Path, recording: Recording) -> list[Path]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6, 6), layout="constrained")
    axes = figure.add_subplot()
    for track in recording.tracks:
        axes.plot(track.lon_deg, track.lat_deg, lw=0.8, label=track.name)
    axes.set(xlabel="longitude, deg", ylabel="latitude, deg", title="Tracks")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
    return _saved(figure, folder / "map")


def _saved(figure: object, stem: Path) -> list[Path]:
    paths = [stem.with_suffix(".png"), stem.with_suffix(".svg")]
    for path in paths:
        figure.savefig(path, dpi=130)  # type: ignore[attr-defined]
    return paths

"""GNSS figures as SVG: sky plot, residuals by elevation, error distribution, Stanford diagram."""

import io
from collections.abc import Sequence
from typing import Any

import numpy as np

from analysis.report.page.figures import new_figure
from analysis.report.page.series_colours import PALETTE, series_colours
from analysis.results import Decision, Result
from analysis.samples.sample import Vector
from mavproxy_fault.documents.extras import has_extra, import_extra

Picture = tuple[str, bytes]  # title, SVG
MOST_POINTS = 30_000
EXCLUDED_COLOUR = "#c2231c"


def gnss_pictures(
    results: Sequence[Result], errors: dict[str, Vector], levels: dict[str, Vector]
) -> list[Picture]:
    """Draw all GNSS figures of the results; none without matplotlib.

    `errors` (n, 2) are the horizontal and vertical error per epoch, keyed by the solution's name;
    `levels` (n, 2) are error and protection level, keyed by direction.
    """
    if not has_extra("matplotlib"):
        return []
    seen = [r for r in results if isinstance(r, Decision) and r.elevation_deg]
    found = []
    if seen:
        table, names = _table(seen)
        elevation, azimuth, _, out, places = table.T
        found = [
            ("Sky plot, excluded in red", draw_sky(elevation, azimuth, out, places, names)),
            ("Residuals by elevation, excluded in red", _residuals(table)),
        ]
    if errors:
        found.append(("Cumulative distribution of errors against the truth", _distribution(errors)))
    found += [(f"Stanford diagram, {name}", _stanford(table)) for name, table in levels.items()]
    return found


def _table(seen: Sequence[Decision]) -> tuple[Vector, list[str]]:
    """Elevation, azimuth, residual, excluded (0 or 1), index of the name (k, 5); and the names."""
    names = sorted({name for decision in seen for name in decision.satellites})
    places = {name: i for i, name in enumerate(names)}
    step = max(1, sum(len(d.satellites) for d in seen) // MOST_POINTS)
    rows = []
    for decision in seen[::step]:
        unknown = (None,) * len(decision.satellites)
        directions = decision.elevation_deg, decision.azimuth_deg
        columns = zip(*directions, decision.residual_m or unknown, decision.satellites, strict=True)
        rows += [(*row, name in decision.excluded, places[name]) for *row, name in columns]
    return np.array(rows, float), names


def _svg(figure: Any) -> bytes:
    mpl = import_extra("matplotlib")
    found = io.BytesIO()
    with mpl.rc_context({"svg.hashsalt": "gnss", "font.size": 9}):
        figure.savefig(found, format="svg", metadata={"Date": None}, dpi=130)
    return found.getvalue()


def draw_sky(
    elevation_deg: Vector, azimuth_deg: Vector, out: Vector, places: Vector, names: Sequence[str]
) -> bytes:
    """Sky plot of directions (k,), excluded (`out`) in red; `places` (k,) index `names`."""
    figure, axes = new_figure(5, 5, projection="polar")
    axes.set_theta_zero_location("N")
    axes.set_theta_direction(-1)
    axes.set(rlim=(0, 90), yticks=(0, 30, 60, 90), yticklabels=("90°", "60°", "30°", ""))
    for i, colour in enumerate(series_colours(list(names))):
        own = places == i
        angle, radius = np.radians(azimuth_deg[own]), 90.0 - elevation_deg[own]
        red = out[own] > 0.0
        axes.scatter(angle, radius, s=3, color=PALETTE[colour], rasterized=True)
        axes.scatter(angle[red], radius[red], s=12, color=EXCLUDED_COLOUR, rasterized=True)
        axes.annotate(names[i], (angle[-1], radius[-1]), fontsize=8)
    return _svg(figure)


def _residuals(table: Vector) -> bytes:
    figure, axes = new_figure(6, 3)
    elevation, _, residual, excluded, _ = table.T
    out = excluded > 0.0
    for rows, colour, size in ((~out, PALETTE[0], 2), (out, EXCLUDED_COLOUR, 4)):
        axes.scatter(elevation[rows], residual[rows], s=size, color=colour, rasterized=True)
    axes.set(xlabel="elevation, deg", ylabel="innovation, m", yscale="symlog")
    axes.grid(alpha=0.3)
    return _svg(figure)


def _distribution(errors: dict[str, Vector]) -> bytes:
    figure, axes = new_figure(6, 3)
    colours = series_colours(list(errors))
    for (name, table), colour in zip(errors.items(), colours, strict=True):
        share = np.arange(1, len(table) + 1) / len(table)
        for column, (kind, line) in enumerate((("horizontal", "-"), ("vertical", "--"))):
            ordered = np.sort(table[:, column])
            axes.plot(ordered, share, line, color=PALETTE[colour], label=f"{name}, {kind}")
    axes.axhline(0.5, color="0.5", lw=0.6)
    axes.axhline(0.95, color="0.5", lw=0.6)
    axes.set(xlabel="error, m", ylabel="share of epochs", ylim=(0, 1))
    axes.legend(loc="lower right", frameon=False)
    return _svg(figure)


def _stanford(table: Vector) -> bytes:
    """Stanford diagram: points below the diagonal are (hazardously) misleading information."""
    figure, axes = new_figure(4, 4)
    axes.loglog(table[:, 0], table[:, 1], ".", ms=2, color=PALETTE[0], rasterized=True)
    ends = min(table.min(), 0.1), table.max() * 2.0
    axes.plot(ends, ends, color=EXCLUDED_COLOUR, lw=0.8)
    axes.set(xlabel="error, m", ylabel="protection level, m")
    axes.grid(alpha=0.3)
    return _svg(figure)

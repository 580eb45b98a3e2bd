"""A flight as a figure: the aircraft in 3D, and truth, sensor signals and estimate over time."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from numpy.typing import NDArray

from analysis.search.evaluation.traced_flight import Trace
from mavproxy_fault.numerics.rotations.rotation import euler_from_quat, matrix_from_quat

Array = NDArray[np.float64]
# outlines in body axes, spans of the wing: wing, fuselage, tailplane, fin
AIRCRAFT = [
    np.array([[0.05, -0.5, 0], [0.05, 0.5, 0], [-0.1, 0.5, 0], [-0.1, -0.5, 0]]),
    np.array([[0.4, 0, 0], [0.1, 0.05, 0], [-0.5, 0.02, 0], [-0.5, -0.02, 0], [0.1, -0.05, 0]]),
    np.array([[-0.4, -0.18, 0], [-0.4, 0.18, 0], [-0.5, 0.18, 0], [-0.5, -0.18, 0]]),
    np.array([[-0.4, 0, 0], [-0.5, 0, 0], [-0.5, 0, -0.18]]),
]
COLOURS = ("tab:blue", "tab:cyan", "tab:blue", "tab:red")
AXES = ("roll", "pitch", "yaw")
NED_TO_PLOT = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # east, north, up


class Picture:
    """Draws one trace at a time into a figure; `at` moves the aircraft."""

    def __init__(self, figure: Figure) -> None:
        self.figure = figure
        grid = figure.add_gridspec(3, 3, width_ratios=(1.3, 1, 1), bottom=0.14, wspace=0.45)
        self._space: Any = figure.add_subplot(grid[:, 0], projection="3d")
        self._angles = [figure.add_subplot(grid[i, 1]) for i in range(3)]
        self._signals = [figure.add_subplot(grid[i, 2]) for i in range(3)]
        self._cursors: list[Any] = []
        self._trace: Trace | None = None
        self._size = 1.0

    def show(self, trace: Trace, title: str) -> None:
        """Plots of a whole flight."""
        self._trace = trace
        self.figure.suptitle(title)
        for axis in (self._space, *self._angles, *self._signals):
            axis.clear()
        t_s = trace.t_s
        # Unwrapped, so that a heading through north draws no vertical line.
        truth = np.degrees(np.unwrap(euler_from_quat(trace.state[:, 6:10]), axis=0))
        # Truth plus error: the estimate stays beside the truth where both wrap.
        estimate = truth + np.degrees(trace.errors_rad()[:, :3])
        for i, axis in enumerate(self._angles):
            axis.plot(t_s, truth[:, i], "k", label="truth")
            axis.plot(t_s, estimate[:, i], "tab:orange", label="estimate")
            axis.set_ylabel(f"{AXES[i]} / deg")
        self._angles[0].legend(loc="upper right", fontsize="small")
        self._plot_signals(trace, t_s)
        for axis in (self._angles[2], self._signals[2]):
            axis.set_xlabel("time / s")
        self._cursors = [a.axvline(0.0, color="grey") for a in (*self._angles, *self._signals)]
        path = trace.state[:, :3] @ NED_TO_PLOT.T
        # A share of the path's extent, or the aircraft would be invisible beside it; at least a
        # metre.
        self._size = max(float(np.ptp(path, axis=0).max()) * 0.15, 1.0)
        self.at(0)

    def _plot_signals(self, trace: Trace, t_s: Array) -> None:
        gyro, accel = np.degrees(trace.measured[:, 0:3]), trace.measured[:, 3:6]
        error = np.degrees(trace.errors_rad())
        for i, colour in enumerate(("tab:red", "tab:green", "tab:blue")):
            self._signals[0].plot(t_s, gyro[:, i], color=colour, linewidth=0.7, label="pqr"[i])
            self._signals[1].plot(t_s, accel[:, i], color=colour, linewidth=0.7, label="xyz"[i])
            self._signals[2].plot(t_s, error[:, i], color=colour, linewidth=0.9, label=AXES[i])
        for axis, label in zip(
            self._signals, ("gyro / deg/s", "accelerometer / m/s²", "error / deg"), strict=True
        ):
            axis.set_ylabel(label)
            axis.legend(loc="upper right", fontsize="x-small", ncols=3)

    def at(self, k: int) -> None:
        """The aircraft at sample `k`: true in colour, as estimated in outline."""
        assert self._trace is not None
        trace, space = self._trace, self._space
        space.clear()
        path = trace.state[:, :3] @ NED_TO_PLOT.T
        space.plot(*path.T, color="grey", linewidth=0.8)
        for q, drawn in ((trace.state[k, 6:10], True), (trace.q_estimate[k], False)):
            rotation = NED_TO_PLOT @ matrix_from_quat(q) * self._size
            shape = [part @ rotation.T + path[k] for part in AIRCRAFT]
            space.add_collection3d(
                Poly3DCollection(shape, facecolors=COLOURS, alpha=0.9)
                if drawn
                else Poly3DCollection(shape, facecolors="none", edgecolors="tab:orange")
            )
        # A cube around the aircraft, so that its shape is not stretched.
        for set_limits, centre in zip(
            (space.set_xlim, space.set_ylim, space.set_zlim), path[k], strict=True
        ):
            set_limits(centre - self._size, centre + self._size)
        space.set_xlabel("east / m")
        space.set_ylabel("north / m")
        space.set_zlabel("up / m")
        for cursor in self._cursors:
            cursor.set_xdata([k * trace.plan.dt_s] * 2)

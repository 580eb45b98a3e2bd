"""`search --interactive`: fly one test at a time, look at it, save it, go on to the next.

Without a display the figures go to PNG files instead.
"""

import csv
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.search.breakdown import flight_of
from analysis.search.cases import yaml_of
from analysis.search.evaluation.compiled_batch import Batch
from analysis.search.evaluation.traced_flight import Trace
from analysis.search.searchers import searcher
from analysis.search.shrink import pinned
from analysis.search.space.test_file import TestFile
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.numerics.rotations.rotation import euler_from_quat

Array = NDArray[np.float64]
UNSEEN = 3  # figures written where there is no display
FRAME_S = 0.1  # flight time between two pictures of the animation
COLUMNS = (
    "t_s", "north_m", "east_m", "down_m", "u_mps", "v_mps", "w_mps", "roll_rad", "pitch_rad",
    "yaw_rad", "p_rps", "q_rps", "r_rps", "gyro_x_rps", "gyro_y_rps", "gyro_z_rps",
    "accel_x_mps2", "accel_y_mps2", "accel_z_mps2", "estimate_roll_rad", "estimate_pitch_rad",
    "estimate_yaw_rad",
)  # fmt: skip


class Session:
    """The tests of a search, one at a time; the searcher learns from each."""

    def __init__(self, test: TestFile, folder: Path) -> None:
        self.test = test
        self.folder = folder
        self.number = -1
        self.worst_deg = 0.0
        self._batch = Batch(test)
        dimension = self._batch.space.dimension
        # Without a dimension every method would divide by it; random points of none are the one
        # test.
        self._searcher = searcher(test.method if dimension else "random", dimension, test.seed, 1)
        self._waiting: list[Array] = []
        self._evaluated: list[tuple[Array, float]] = []
        self.values: dict[str, float] = {}
        self.trace: Trace | None = None
        self.error_deg = 0.0

    def next(self) -> Trace:
        """Fly the next test."""
        # A searcher learns in batches: it is told when all points of one have been flown.
        if not self._waiting:
            if self._evaluated:
                points, fitness = zip(*self._evaluated, strict=True)
                self._searcher.tell(np.array(points), np.array(fitness))
            self._evaluated = []
            self._waiting = list(self._searcher.ask())
        point = self._waiting.pop(0)
        self.number += 1
        values = self._batch.space.values(point[None, :])
        self.values = {name: float(value[0]) for name, value in values.items()}
        self.trace = flight_of(self.test, self.values, self.test.seed, self.number)
        # Flown twice: the trace for the eye, the batch for the very fitness that `search` sees.
        outcome = self._batch.evaluate(point[None, :], self.test.seed, self.number, 1)
        self.error_deg = float(outcome.fitness[0])
        self.worst_deg = max(self.worst_deg, self.error_deg)
        self._evaluated.append((point, self.error_deg))
        return self.trace

    @property
    def title(self) -> str:
        """What stands above the figure."""
        # Fitness is zero or less only where the flight left the envelope.
        if self.error_deg <= 0.0:
            return f"test {self.number}: left the envelope"
        return (
            f"test {self.number}: {self.test.estimator} errs by {self.error_deg:.3f} deg"
            f" (worst so far {self.worst_deg:.3f} deg)"
        )

    def save(self) -> list[Path]:
        """Time series as CSV and the case as a test file."""
        assert self.trace is not None
        self.folder.mkdir(parents=True, exist_ok=True)
        table = self.folder / f"test-{self.number:04}.csv"
        with table.open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(COLUMNS)
            writer.writerows(table_of(self.trace).tolist())
        case = self.folder / f"test-{self.number:04}.yaml"
        case.write_text(yaml_of(pinned(self.test, self.values)))
        return [table, case]


def table_of(trace: Trace) -> Array:
    """The columns of COLUMNS (n, 22)."""
    euler = euler_from_quat(trace.state[:, 6:10])
    return np.column_stack(
        [
            trace.t_s,
            trace.state[:, :6],
            euler,
            trace.state[:, 10:13],
            trace.measured[:, :6],
            euler_from_quat(trace.q_estimate),
        ]
    )


def show(test: TestFile, folder: Path) -> int:
    """Open the window, or write figures where there is no display.

    Raises
    ------
    ConfigError
        If the simulator flies the test, which leaves no trace to draw.
    """
    if test.flown:
        raise ConfigError(
            "--interactive: shows flights of the compiled kernels; leave out scenario, and choose"
            " another estimator than autopilot or fusion"
        )
    import matplotlib.pyplot as plt

    from analysis.search.picture import Picture

    session = Session(test, folder)
    figure = plt.figure(figsize=(14, 8))
    picture = Picture(figure)
    # Backends that draw into files only.
    if plt.get_backend().lower() in ("agg", "pdf", "svg", "ps", "cairo", "template"):
        for _ in range(UNSEEN):
            trace = session.next()
            picture.show(trace, session.title)
            # The middle of the flight: at its start all flights look alike.
            picture.at(len(trace.state) // 2)
            saved = session.save()
            image = folder / f"test-{session.number:04}.png"
            figure.savefig(image)
            print(*saved, image, sep="\n")
        print("There is no display; MPLBACKEND=webagg shows the flights in a browser.")
        plt.close(figure)
        return 0
    window = Window(session, picture)
    window.next()
    plt.show()
    return 0


class Window:
    """The buttons below the figure and the animation."""

    def __init__(self, session: Session, picture: Any) -> None:
        from matplotlib.widgets import Button

        self.session, self.picture = session, picture
        self._k = 0
        figure = picture.figure
        self._buttons = []
        for i, (label, action) in enumerate(
            (("next test", self.next), ("animate", self.play), ("save data", self.save))
        ):
            button = Button(figure.add_axes((0.05 + 0.12 * i, 0.02, 0.1, 0.05)), label)
            button.on_clicked(action)
            # Matplotlib keeps callbacks weakly: an unreferenced button would stop working.
            self._buttons.append(button)
        # Milliseconds between pictures of the animation.
        self._timer = figure.canvas.new_timer(interval=30)
        self._timer.add_callback(self.frame)

    def next(self, _event: Any = None) -> None:
        """Fly and draw the next test."""
        self._timer.stop()
        self._k = 0
        self.picture.show(self.session.next(), self.session.title)
        self.picture.figure.canvas.draw_idle()

    def play(self, _event: Any = None) -> None:
        """Fly the aircraft along its path from the start."""
        self._k = 0
        self._timer.start()

    def frame(self) -> bool:
        """One picture of the animation; whether there is another."""
        trace = self.session.trace
        assert trace is not None
        self.picture.at(self._k)
        self.picture.figure.canvas.draw_idle()
        self._k += max(1, round(FRAME_S / trace.plan.dt_s))
        if self._k < len(trace.state):
            return True
        self._timer.stop()
        return False

    def save(self, _event: Any = None) -> list[Path]:
        """Save the data of the test on show."""
        return self.session.save()

"""A scripted session with the figure, without a display."""

import csv

import matplotlib
import numpy as np
import pytest

from analysis.search.interactive import COLUMNS, Session, Window, show
from analysis.search.space.test_file import Initial, TestFile, read_test

TEST = TestFile(duration_s=1.0, initial=Initial(roll_deg=(-30.0, 30.0)))


@pytest.fixture
def plt():
    before = matplotlib.get_backend()
    matplotlib.use("agg")
    import matplotlib.pyplot as pyplot

    yield pyplot
    pyplot.close("all")
    matplotlib.use(before)


def test_a_session_steps_animates_and_saves(tmp_path, plt):
    from analysis.search.picture import Picture

    window = Window(Session(TEST, tmp_path), Picture(plt.figure()))
    window.next()
    first = window.session.trace
    window.play()
    frames = 1
    while window.frame():
        frames += 1
    assert frames == 11
    window.next()
    assert window.session.number == 1
    assert not np.array_equal(window.session.trace.state, first.state)
    table, case = window.save()
    with table.open() as file:
        rows = list(csv.reader(file))
    assert tuple(rows[0]) == COLUMNS
    assert len(rows) == 102
    assert float(rows[1][7]) == pytest.approx(np.radians(read_test(case).initial.roll_deg))


def test_a_session_learns_like_the_search(tmp_path):
    session = Session(TEST, tmp_path)
    for _ in range(70):
        session.next()
    assert session.number == 69
    assert session.worst_deg >= session.error_deg


def test_without_a_display_figures_are_written(tmp_path, plt, capsys):
    assert show(TEST, tmp_path) == 0
    assert len(list(tmp_path.glob("*.png"))) == 3
    assert len(list(tmp_path.glob("*.csv"))) == 3
    assert "test-0002.png" in capsys.readouterr().out

"""A search that is looked at, one test at a time."""

import csv

import numpy as np
import pytest

from analysis.search.search_session import COLUMNS, SearchSession
from analysis.search.space.test_file import InitialState, TestFile, read_test

TEST = TestFile(duration_s=1.0, initial=InitialState(roll_deg=(-30.0, 30.0)))


def test_a_session_steps_and_saves(tmp_path):
    session = SearchSession(TEST, tmp_path)
    first = session.next()
    second = session.next()
    assert session.number == 1
    assert not np.array_equal(second.truth, first.truth)
    table, case = session.save()
    with table.open() as file:
        rows = list(csv.reader(file))
    assert tuple(rows[0]) == COLUMNS
    assert len(rows) == 101
    roll_rad = np.radians(read_test(case).initial.roll_deg)
    assert float(rows[1][7]) == pytest.approx(roll_rad, rel=1e-3)


def test_a_session_learns_like_the_search(tmp_path):
    session = SearchSession(TEST, tmp_path)
    for _ in range(70):
        session.next()
    assert session.number == 69
    assert session.worst >= session.error


def test_the_title_has_the_unit_of_the_criterion(tmp_path):
    test = TestFile(
        duration_s=1.0, estimator="inverse-model", criterion="height",
        initial=InitialState(roll_deg=(-30.0, 30.0)),
    )  # fmt: skip
    session = SearchSession(test, tmp_path)
    session.next()
    assert f"error of inverse-model {session.error:.3f} m (worst so far" in session.title

"""Searchers: within the cube, repeatable, and better than chance on a hill."""

import numpy as np
import pytest

from analysis.search.searchers import METHODS, make_searcher
from mavproxy_fault.documents.errors import ConfigError

TOP = np.array([0.2, 0.7, 0.4, 0.9])


def hill(points):
    return 1.0 - np.sqrt(((points - TOP) ** 2).sum(axis=1))


def search(method, seed, budget, function=hill):
    made = make_searcher(method, 4, seed, budget)
    points, values = [], []
    while sum(map(len, points)) < budget:
        asked = made.ask()
        found = function(asked)
        made.report(asked, found)
        points.append(asked)
        values.append(found)
    return np.concatenate(points), np.concatenate(values)


@pytest.mark.parametrize("method", METHODS)
def test_points_lie_in_the_unit_cube_and_follow_from_the_seed(method):
    first, _ = search(method, 3, 400)
    again, _ = search(method, 3, 400)
    other, _ = search(method, 4, 400)
    assert (first == again).all()
    assert not np.array_equal(first[:50], other[:50])
    assert first.min() >= 0.0
    assert first.max() <= 1.0


@pytest.mark.parametrize("method", ["matyas", "cmaes", "mixed"])
def test_a_learning_searcher_climbs_higher_than_chance(method):
    chance = np.median([search("random", seed, 500)[1][:500].max() for seed in range(5)])
    found = np.median([search(method, seed, 500)[1][:500].max() for seed in range(5)])
    assert found > chance


@pytest.mark.parametrize("method", ["cmaes", "mixed"])
def test_a_searcher_goes_on_after_it_has_converged(method):
    points, values = search(method, 1, 4000)
    assert len(points) >= 4000
    assert values.max() > 0.99


@pytest.mark.parametrize("method", METHODS)
def test_a_searcher_goes_on_where_all_points_are_alike(method):
    points, _ = search(method, 1, 400, lambda points: np.zeros(len(points)))
    assert len(points) >= 400


def test_a_searcher_leaves_numpys_global_generator_alone():
    np.random.seed(1)  # noqa: NPY002
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    search("mixed", 1, 200)
    assert (np.random.get_state()[1] == before).all()  # noqa: NPY002


def test_a_search_of_many_evaluations_asks_for_several_islands_at_once():
    made = make_searcher("mixed", 4, 1, 100_000)
    made.report(first := made.ask(), hill(first))
    assert len(made.ask()) >= 80


def test_an_unknown_method_is_the_users_error():
    with pytest.raises(ConfigError, match="known: cmaes, matyas, mixed, random, sobol"):
        make_searcher("luck", 4, 1, 10)

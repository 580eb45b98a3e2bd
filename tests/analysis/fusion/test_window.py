"""The window's blocks: what is kept, and that they leave without stirring up the rest."""

import gtsam
import numpy as np
import pytest

from analysis.fusion.factors.unary_factors import NO_CLOCK, isotropic_noise, walk_factor
from analysis.fusion.window import FactorWindow, variable_key

LAG_S, STEP_S, EPOCHS = 1.0, 0.2, 24


@pytest.fixture(scope="module")
def chain():
    """After each epoch of a chain: how many are in the window, how many were eliminated."""
    window, rows = FactorWindow(LAG_S), []
    for epoch in range(EPOCHS):
        name, stamp_s = variable_key("c", epoch), window.stamp(epoch * STEP_S)
        values = gtsam.Values()
        values.insert(name, NO_CLOCK)
        window.insert(values, (name,), stamp_s)
        if epoch == 0:
            window.attach(
                "prior", 0, 0.0, gtsam.PriorFactorVector(name, NO_CLOCK, isotropic_noise(2, 1.0))
            )
        else:
            since_s = window.stamp((epoch - 1) * STEP_S)
            window.attach("walk", epoch, since_s, walk_factor(name - 1, name, 1.0, 2))
        window.commit()
        result = window.smoother.getISAM2Result()
        size = window.smoother.getLinearizationPoint().size()
        rows.append((size, result.getVariablesReeliminated()))
    return np.array(rows)


def test_the_window_is_between_one_and_two_lags_long(chain):
    in_lag = round(LAG_S / STEP_S)
    sizes = chain[2 * in_lag :, 0]
    assert set(sizes) == set(range(in_lag + 1, 2 * in_lag + 1))


def test_a_block_leaves_without_anything_else_being_eliminated_anew(chain):
    sizes, eliminated = chain[4:].T
    assert (np.diff(sizes) < 0).sum() == 3
    assert len(set(eliminated)) == 1


def test_a_factor_attached_to_what_leaves_in_the_same_update_is_forgotten():
    window = FactorWindow(LAG_S)
    for epoch in range(2 * round(LAG_S / STEP_S) + 1):
        name, stamp_s = variable_key("c", epoch), window.stamp(epoch * STEP_S)
        values = gtsam.Values()
        values.insert(name, NO_CLOCK)
        window.insert(values, (name,), stamp_s)
        window.attach(
            "prior", epoch, stamp_s, gtsam.PriorFactorVector(name, NO_CLOCK, isotropic_noise(2, 1))
        )
        if epoch == 2 * round(LAG_S / STEP_S):  # the first block leaves: its first epoch's prior
            assert window.remove("prior", 0)  # is changed at the last moment
            again = gtsam.PriorFactorVector(variable_key("c", 0), NO_CLOCK, isotropic_noise(2, 2.0))
            window.attach("prior", 0, 0.0, again)
        window.commit()
    assert window.slots("prior", 0) == ()
    assert all(epoch >= round(LAG_S / STEP_S) for _, epoch in window.committed())

"""The bank's algebra against refiltering, and its statistics."""

import numpy as np
import pytest

from analysis.detection.isolation.hypotheses import select_hypothesis
from analysis.detection.statistics.bank import (
    best_subset,
    freed_statistic,
    projected_weights,
)
from analysis.detection.statistics.chi_square import chi_square_threshold

RNG = np.random.default_rng(5)


def geometry(count: int, rng: np.random.Generator) -> np.ndarray:
    """Random open sky with PDOP below 4: minus unit vectors and the clock (count, 4)."""
    while True:
        azimuth = rng.uniform(0.0, 2.0 * np.pi, count)
        sine = rng.uniform(np.sin(np.radians(10.0)), 1.0, count)
        cosine = np.sqrt(1.0 - sine**2)
        design = np.column_stack(
            [-cosine * np.sin(azimuth), -cosine * np.cos(azimuth), -sine, np.ones(count)]
        )
        if np.trace(np.linalg.inv(design.T @ design)[:3, :3]) < 16.0:
            return design


def innovations(count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Geometry, covariance with position and clock predicted to 1 sigma, and a clean draw."""
    design = geometry(count, rng)
    s = design @ design.T + np.eye(count)
    return design, s, np.linalg.cholesky(s) @ rng.standard_normal(count)


@pytest.mark.parametrize("size", [1, 2, 3])
def test_leaving_out_by_algebra_equals_testing_without(size: int):
    _, s, v = innovations(8, RNG)
    m = np.linalg.inv(s)
    q, pick = best_subset(m, m @ v, float(v @ m @ v), size)
    keep = np.setdiff1d(np.arange(8), pick)
    direct = v[keep] @ np.linalg.inv(s[np.ix_(keep, keep)]) @ v[keep]
    assert q == pytest.approx(direct, rel=1e-9)


def test_no_other_pair_leaves_less():
    _, s, v = innovations(7, RNG)
    m = np.linalg.inv(s)
    q, _ = best_subset(m, m @ v, float(v @ m @ v), 2)
    for i in range(7):
        for j in range(i):
            keep = np.setdiff1d(np.arange(7), [i, j])
            assert q <= v[keep] @ np.linalg.inv(s[np.ix_(keep, keep)]) @ v[keep] + 1e-9


def test_freeing_position_and_clock_gives_the_least_squares_residual():
    design, _, v = innovations(9, RNG)
    s = np.eye(9)
    projected = projected_weights(design, np.ones(9))
    residual = v - design @ np.linalg.lstsq(design, v, rcond=None)[0]
    assert v @ projected @ v == pytest.approx(residual @ residual, rel=1e-9)
    assert freed_statistic(s, v, float(v @ v), design) == pytest.approx(
        residual @ residual, rel=1e-9
    )


def test_normalised_innovations_are_standard_normal():
    draws = []
    rng = np.random.default_rng(1)
    for _ in range(2000):
        _, s, v = innovations(8, rng)
        m = np.linalg.inv(s)
        draws.append(m @ v / np.sqrt(np.diag(m)))
    z = np.concatenate(draws)
    # 16000 values, correlated within an epoch: at least 2000 independent ones
    assert abs(z.std() - 1.0) < 4.0 / np.sqrt(2.0 * 2000)


def verdicts(kind: str, bias: float, trials: int, rule: str = "explicit") -> dict[str, float]:
    """Shares of verdicts over alarms and none, m = 10, Pfa 1e-4."""
    rng = np.random.default_rng(11)
    counts: dict[str, int] = {}
    for _ in range(trials):
        design, s, v = innovations(10, rng)
        bad: tuple[int, ...] = ()
        if kind == "imu":
            turn = rng.standard_normal(3)
            v = v + design[:, :3] @ (bias * turn / np.linalg.norm(turn))
        else:
            bad = tuple(sorted(int(i) for i in rng.choice(10, int(kind), replace=False)))
            v[list(bad)] += bias * rng.choice([-1.0, 1.0], len(bad))
        m = np.linalg.inv(s)
        name = "none"
        if v @ m @ v > chi_square_threshold(10, 1e-4):
            found = select_hypothesis(
                m, v, design[:, :3].copy(), design[:, 3:].copy(), 1e-4, 3, rule
            )
            name = found.hypothesis
            if name == "satellites":
                name = "right" if found.subset == bad else "wrong"
        counts[name] = counts.get(name, 0) + 1
    return {name: number / trials for name, number in counts.items()}


@pytest.mark.parametrize("kind", ["1", "2"])
def test_one_or_two_bad_satellites_are_found(kind: str):
    assert verdicts(kind, 10.0, 400).get("right", 0.0) > 0.98  # 0.995 less four binomial sigma


def test_a_wrong_position_is_the_imu_s():
    assert verdicts("imu", 12.0, 400).get("imu", 0.0) > 0.97


@pytest.mark.parametrize("kind", ["3", "5"])
def test_many_faulty_satellites_do_not_isolate_the_imu(kind: str):
    assert verdicts(kind, 10.0, 400).get("imu", 0.0) <= 0.03  # 1 % and four binomial sigma


def test_the_plain_rule_isolates_the_imu_for_satellites():
    assert verdicts("5", 10.0, 200, "plain").get("imu", 0.0) > 0.9


def test_the_main_test_has_the_configured_false_alarm_rate():
    rng = np.random.default_rng(3)
    alarms = 0
    for _ in range(40):
        design = geometry(10, rng)
        s = design @ design.T + np.eye(10)
        v = rng.standard_normal((5000, 10)) @ np.linalg.cholesky(s).T
        alarms += int(
            (
                np.einsum("ni,ij,nj->n", v, np.linalg.inv(s), v) > chi_square_threshold(10, 1e-3)
            ).sum()
        )
    assert 162 <= alarms <= 239  # 99 % binomial interval of 200 000 trials at 1e-3

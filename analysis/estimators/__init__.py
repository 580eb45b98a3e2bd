"""Attitude estimators under test, one file each; plugins register by entry point.

An entry point of the group `mavproxy_fault.estimators` names a function without arguments that
returns an `Estimator` (see `estimator`).
"""

from importlib.metadata import EntryPoint, entry_points

from analysis.estimators.estimator import AttitudeEstimate, Estimator, Prior, estimate_block
from mavproxy_fault.documents.errors import ConfigError

__all__ = [
    "AttitudeEstimate",
    "Estimator",
    "Prior",
    "estimate_block",
    "estimator_names",
    "make_estimator",
]

GROUP = "mavproxy_fault.estimators"
# Loaded by name: an estimator that is not used is not imported.
BUILT_IN = {
    name: EntryPoint(name, f"analysis.estimators.{place}", GROUP)
    for name, place in (
        ("complementary", "complementary:complementary"),
        ("ekf", "ekf:Ekf"),
        ("fusion", "graph_estimator:FusedAttitude"),
        ("inverse-model", "inverse_model:InverseModel"),
        ("madgwick", "madgwick:Madgwick"),
        ("mahony", "complementary:Mahony"),
    )
}


def estimator_names() -> list[str]:
    """Names of all estimators, built in and registered, sorted."""
    return sorted(BUILT_IN.keys() | {point.name for point in entry_points(group=GROUP)})


def make_estimator(name: str) -> Estimator:
    """Create the estimator of that name with its default parameters.

    Raises
    ------
    ConfigError
        If nothing of that name is registered.
    """
    # Built-in names come first: a plugin cannot replace one.
    point = BUILT_IN.get(name) or next(iter(entry_points(group=GROUP, name=name)), None)
    if point is None:
        raise ConfigError(f"estimator: {name!r} is unknown; known: {', '.join(estimator_names())}")
    estimator: Estimator = point.load()()
    return estimator

"""Attitude estimators under test, one file each; plugins register by entry point.

An entry point of the group `mavproxy_fault.estimators` names a function without arguments that
returns an `Estimator` (see `estimator`).
"""

from collections.abc import Callable
from importlib import import_module
from importlib.metadata import entry_points

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
BUILT_IN = {
    "complementary": "analysis.estimators.complementary:complementary",
    "ekf": "analysis.estimators.ekf:Ekf",
    "fusion": "analysis.estimators.graph_estimator:FusedAttitude",
    "inverse-model": "analysis.estimators.inverse_model:InverseModel",
    "madgwick": "analysis.estimators.madgwick:Madgwick",
    "mahony": "analysis.estimators.complementary:Mahony",
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
    factory: Callable[[], Estimator]
    if name in BUILT_IN:
        # Imported by name: an estimator that is not used is not loaded.
        module, _, attribute = BUILT_IN[name].partition(":")
        factory = getattr(import_module(module), attribute)
        return factory()
    # Built-in names come first: a plugin cannot replace one.
    for point in entry_points(group=GROUP, name=name):
        factory = point.load()
        return factory()
    raise ConfigError(f"estimator: {name!r} is unknown; known: {', '.join(estimator_names())}")

"""The positions of a RINEX recording's satellites, for faults that generate their signals."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from analysis.detection.detection_config import DetectorConfig
from analysis.detection.filter.ephemerides import StoredOrbit, select_ephemerides
from analysis.detection.filter.inertial import X_SIZE
from analysis.detection.filter.measurement import observe_epoch
from analysis.detection.sky_geometry import NO_IONOSPHERE, epochs_of, orbits_of
from analysis.detection.stages.initial_fix import solve_snapshot
from analysis.orbits.broadcast import POSITION, VELOCITY
from analysis.recordings.read_recordings import read_rinex
from analysis.samples.sample import Epoch, Vector
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.numerics.earth_kernel import local_axes

LEAST_SATELLITES = 6  # satellites: two systems' unknowns and one to spare


def recorded_sky(
    observations: Path, navigation: Sequence[Path]
) -> Callable[[int], Mapping[str, Vector]]:
    """A function of the stamp of an epoch: to each satellite with an orbit, north, east and down
    of the receiver [m], and how that changes [m/s] (6,).

    The receiver is at the position of the first epoch with enough satellites: a kilometre further
    on a satellite's direction differs by 0.05 mrad.

    Raises
    ------
    ConfigError
        If a file cannot be read, or no epoch gives a position.
    """
    block = read_rinex(observations, navigation)
    epochs, orbits = epochs_of(block), orbits_of(block)
    fixes = (locate_receiver(epoch, orbits) for epoch in epochs.values())
    r_ecef_m = next((place for place in fixes if place is not None), None)
    if r_ecef_m is None:
        raise ConfigError(
            f"{observations}: no epoch gives a position; a spoof needs one with {LEAST_SATELLITES}"
            " satellites that have an ephemeris"
        )
    axes = local_axes(r_ecef_m)

    def sky(t_us: int) -> dict[str, Vector]:
        epoch = epochs.get(t_us)
        if epoch is None:
            return {}
        observation = observe_epoch(epoch, select_ephemerides(epoch, orbits))
        if observation is None:
            return {}
        states = observation.satellite_states
        place = (states[:, POSITION : POSITION + 3] - r_ecef_m) @ axes.T
        motion = states[:, VELOCITY : VELOCITY + 3] @ axes.T
        return dict(zip(observation.satellites, np.hstack([place, motion]), strict=True))

    return sky


def locate_receiver(epoch: Epoch, orbits: dict[str, tuple[StoredOrbit, ...]]) -> Vector | None:
    """The receiver (3,), ECEF [m], by one epoch alone."""
    selection = select_ephemerides(epoch, orbits)
    observation = observe_epoch(epoch, selection)
    if observation is None or len(observation.satellites) < LEAST_SATELLITES:
        return None
    x = solve_snapshot(observation, np.zeros(X_SIZE), DetectorConfig(), NO_IONOSPHERE)
    return None if x is None else x[:3]

"""The sky of a recording: of its decisions, and for faults that generate its satellites' signals.

That of decisions (elevation, azimuth, C/N0, signals, dilution of precision) is computed after
detection, from the same orbits, so that it costs the tests nothing.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from msgspec.structs import replace

from analysis.detection.detection_config import DetectorConfig
from analysis.detection.filter.ephemerides import (
    EphemerisSelection,
    StoredOrbit,
    select_ephemerides,
)
from analysis.detection.filter.inertial import X_SIZE
from analysis.detection.filter.measurement import observe_epoch
from analysis.detection.stages.initial_fix import solve_snapshot
from analysis.orbits.broadcast import (
    AZIMUTH,
    ELEVATION,
    LINE_OF_SIGHT,
    POSITION,
    VELOCITY,
    design_matrix,
    pack_ephemeris,
    predict_ranges,
)
from analysis.recordings.read_recordings import read_rinex
from analysis.results import Decision, Result
from analysis.samples.block import EPHEMERIS, EPOCH, Block, Indices
from analysis.samples.sample import EphemerisSample, Epoch, Vector
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.numerics.earth_kernel import local_axes

NO_IONOSPHERE = np.zeros(8)  # only directions are needed
AT_REST = np.zeros(3)
LEAST_SATELLITES = 6  # two systems' unknowns and one to spare


class RecordedSky:
    """The sky of a complete recording, for its results in blocks of any size."""

    def __init__(self, block: Block, config: DetectorConfig) -> None:
        self._epochs, self._orbits = epochs_of(block), orbits_of(block)
        self._systems = config.systems
        self._selection: EphemerisSelection | None = None

    def add_sky(self, results: Sequence[Result]) -> list[Result]:
        """The results; decisions get the sky above their position."""
        return [
            self._with_sky(result) if isinstance(result, Decision) else result for result in results
        ]

    def _with_sky(self, decision: Decision) -> Decision:
        epoch = self._epochs.get(decision.t_us)
        if epoch is None or not decision.position_ecef_m:
            return decision
        if self._selection is None or not self._selection.is_valid_for(epoch):
            self._selection = select_ephemerides(epoch, self._orbits, self._systems)
        observation = observe_epoch(epoch, self._selection)
        if observation is None or not set(decision.satellites) <= set(observation.satellites):
            return decision
        r_ecef_m, measured = np.array(decision.position_ecef_m), observation.measurements
        table = predict_ranges(
            observation.satellite_states, r_ecef_m, AT_REST, measured.tow_s, NO_IONOSPHERE
        )
        places = {name: i for i, name in enumerate(observation.satellites)}
        at = [places[name] for name in decision.satellites]
        signals = dict(zip(epoch.satellites, epoch.signals, strict=False))
        used = [places[name] for name in decision.satellites if name not in decision.excluded]
        lines_of_sight = table[used, LINE_OF_SIGHT : LINE_OF_SIGHT + 3]
        hdop, vdop = _dilution(lines_of_sight, measured.system[used], r_ecef_m)
        return replace(
            decision,
            elevation_deg=tuple(np.degrees(table[at, ELEVATION]).round(2).tolist()),
            azimuth_deg=tuple((np.degrees(table[at, AZIMUTH]) % 360.0).round(2).tolist()),
            cn0_dbhz=tuple(c if math.isfinite(c) else None for c in measured.cn0_dbhz[at].tolist()),
            signals=tuple(signals.get(name, "") for name in decision.satellites),
            hdop=hdop,
            vdop=vdop,
        )


def epochs_of(block: Block) -> dict[int, Epoch]:
    """All epochs of a recording by their stamp."""
    samples = [block.beside[row] for row in block.rows(EPOCH).tolist()]
    return {sample.t_us: sample for sample in samples if isinstance(sample, Epoch)}


def orbits_of(block: Block) -> dict[str, tuple[StoredOrbit, ...]]:
    """All orbits of a recording by satellite."""
    found: dict[str, tuple[StoredOrbit, ...]] = {}
    for row in block.rows(EPHEMERIS).tolist():
        sample = block.beside[row]
        assert isinstance(sample, EphemerisSample)
        name = sample.ephemeris.satellite
        own = (sample.ephemeris, pack_ephemeris(sample.ephemeris))
        found[name] = (*found.get(name, ()), own)
    return found


def _dilution(
    line_of_sight: Vector, system: Indices, r_ecef_m: Vector
) -> tuple[float | None, float | None]:
    """Horizontal and vertical dilution of precision of satellites in the directions (n, 3)."""
    design = design_matrix(line_of_sight, system)
    if len(design) < design.shape[1] or np.linalg.matrix_rank(design) < design.shape[1]:
        return None, None
    axes = local_axes(r_ecef_m)
    north, east, down = np.diag(axes @ np.linalg.inv(design.T @ design)[:3, :3] @ axes.T)
    return round(math.sqrt(north + east), 3), round(math.sqrt(down), 3)


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

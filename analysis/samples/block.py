"""Blocks: consecutive samples as one table, read from a log or received on a link.

A row has its kind, timestamp and values; samples that do not fit a row (epochs, ephemerides) are
kept in a dictionary by row number. Every processing step accepts blocks of any length and gives the
same results however a stream is divided into blocks.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from analysis.samples.sample import (
    AirspeedSample,
    AttitudeSample,
    BaroSample,
    CommandSample,
    EphemerisSample,
    Epoch,
    GpsFix,
    ImuSample,
    IonosphereSample,
    MagSample,
    RangeSample,
    Sample,
    SpareSample,
    TruthSample,
    Vector,
    VisionSample,
)

Stamps = NDArray[np.int64]
Indices = NDArray[np.int64]
NEVER_US = -(1 << 62)  # before every stamp
FIX_3D = 3  # least fix type with a position, as in GPS_FIX_TYPE

# The longest row, the truth, has 4 + 3 + 3 + 3 values.
WIDTH = 13
IMU, MAG, BARO, AIRSPEED, RANGE, VISION, TRUTH, ATTITUDE = range(8)
FIX, EPOCH, EPHEMERIS, IONOSPHERE = range(8, 12)  # events: samples that may cause a decision
COMMAND = 12  # last, as its timestamp may be of another clock than the sensors'
SPARE = 13  # a redundant sensor
# A row holds the index of its message's name.
SOURCES = (
    *("HIL_GPS", "GPS_RAW_INT", "ATTITUDE", "ATTITUDE_QUATERNION"),
    *("HIL_ACTUATOR_CONTROLS", "OUTPUTS"),
)
CONTROLS, OUTPUTS = SOURCES.index("HIL_ACTUATOR_CONTROLS"), SOURCES.index("OUTPUTS")
# Column offsets within a row (see `FORMS`).
RATES, FORCE, IMU_ID = 0, 3, 6  # of an IMU
FIX_VELOCITY, FIX_TYPE = 3, 6  # of a fix
ATTITUDE_SOURCE, COMMAND_SOURCE = 5, 12  # behind quaternion and system id, behind the outputs
SPARE_KIND, SPARE_ID, SPARE_NUMBERS = range(3)  # of a redundant sensor


class RowField(NamedTuple):
    """A field of a sample in a row: how many numbers it takes, and its conversion from and to
    them."""

    width: int
    read: Callable[[Vector], Any]
    write: Callable[[Any], Iterable[float]]


def _known_velocity(v: Vector) -> Vector | None:
    """A velocity; None if all components are unknown."""
    # All three, since GPS_RAW_INT gives two components only.
    return None if np.isnan(v).all() else v


NUMBER = RowField(1, lambda v: float(v[0]), lambda x: (x,))
WHOLE = RowField(1, lambda v: int(v[0]), lambda x: (x,))
SOURCE = RowField(1, lambda v: SOURCES[int(v[0])], lambda name: (SOURCES.index(name),))
THREE, FOUR, SIX, TWELVE = (RowField(n, lambda v: v, lambda v: v) for n in (3, 4, 6, 12))
VELOCITY = RowField(3, _known_velocity, lambda v: (np.nan,) * 3 if v is None else v)
# The class of each kind, and the fields of its rows; of those without any the samples are kept.
FORMS: dict[int, tuple[type, tuple[RowField, ...]]] = {
    IMU: (ImuSample, (THREE, THREE, WHOLE)),
    MAG: (MagSample, (THREE,)),
    BARO: (BaroSample, (NUMBER, NUMBER)),
    AIRSPEED: (AirspeedSample, (NUMBER,)),
    RANGE: (RangeSample, (NUMBER,)),
    VISION: (VisionSample, (THREE, VELOCITY, FOUR)),
    TRUTH: (TruthSample, (FOUR, THREE, NUMBER, NUMBER, NUMBER, THREE)),
    ATTITUDE: (AttitudeSample, (FOUR, WHOLE, SOURCE)),
    FIX: (GpsFix, (*[NUMBER] * 3, VELOCITY, WHOLE, WHOLE, NUMBER, NUMBER, SOURCE)),
    EPOCH: (Epoch, ()),
    EPHEMERIS: (EphemerisSample, ()),
    IONOSPHERE: (IonosphereSample, ()),
    COMMAND: (CommandSample, (TWELVE, SOURCE)),
    SPARE: (SpareSample, (WHOLE, WHOLE, SIX)),
}
KINDS: dict[type, int] = {sample: kind for kind, (sample, _) in FORMS.items()}


class Block(NamedTuple):
    """Table of n samples in order.

    `kind` and `t_us` (n,); `values` (n, WIDTH): the samples' fields in order (see `FORMS`);
    `beside` holds the samples that are not rows of numbers, by row number.
    """

    kind: Indices
    t_us: Stamps
    values: Vector
    beside: Mapping[int, Sample]

    def rows(self, kind: int) -> Indices:
        """The row numbers of the samples of one kind."""
        return np.flatnonzero(self.kind == kind)

    def sample(self, row: int) -> Sample:
        """The sample of a row; its vectors are views of the table."""
        sample, fields = FORMS[int(self.kind[row])]
        if not fields:
            return self.beside[row]
        values, parts, at = self.values[row], [], 0
        for field in fields:
            parts.append(field.read(values[at : at + field.width]))
            at += field.width
        found: Sample = sample(int(self.t_us[row]), *parts)
        return found

    def samples(self) -> Iterator[Sample]:
        """Iterate over the samples."""
        return (self.sample(row) for row in range(len(self.kind)))

    def between(self, begin: int, end: int) -> "Block":
        """The rows from `begin` to before `end`, as views of the table."""
        beside = {row - begin: sample for row, sample in self.beside.items() if begin <= row < end}
        return Block(self.kind[begin:end], self.t_us[begin:end], self.values[begin:end], beside)

    def where(self, keep: NDArray[np.bool_]) -> "Block":
        """The rows selected by the mask `keep` (n,)."""
        # New row number of each kept row.
        to = np.cumsum(keep) - 1
        beside = {int(to[row]): sample for row, sample in self.beside.items() if keep[row]}
        return Block(self.kind[keep], self.t_us[keep], self.values[keep], beside)


def block_of(samples: Sample | Iterable[Sample] | Block) -> Block:
    """Convert samples to a block; a block stays as it is."""
    if isinstance(samples, Block):
        return samples
    # A lone sample is the common case on a live link.
    listed: Sequence[Sample] = (samples,) if isinstance(samples, Sample) else tuple(samples)
    count = len(listed)
    kind, t_us = np.empty(count, np.int64), np.empty(count, np.int64)
    values = np.zeros((count, WIDTH))
    beside: dict[int, Sample] = {}
    for row, sample in enumerate(listed):
        kind[row], t_us[row] = KINDS[type(sample)], sample.t_us
        fields = FORMS[KINDS[type(sample)]][1]
        if not fields:
            beside[row] = sample
        # The first attribute is the timestamp.
        parts = (getattr(sample, name) for name in sample.__slots__[1 : len(fields) + 1])
        numbers = [x for f, part in zip(fields, parts, strict=True) for x in f.write(part)]
        values[row, : len(numbers)] = numbers
    return Block(kind, t_us, values, beside)


class BlockPart(NamedTuple):
    """Rows of one kind read from one message; `order` (m,) is the sort key of each row within the
    block, `values` has shape (m, k) with k up to WIDTH."""

    kind: int
    order: Indices
    t_us: Stamps
    values: Vector


def join_parts(parts: Sequence[BlockPart], beside: Sequence[tuple[int, Sample]]) -> Block:
    """Merge parts and (sort key, sample) pairs into one block."""
    order = np.concatenate([*(p.order for p in parts), np.array([at for at, _ in beside], int)])
    count = len(order)
    row = np.empty(count, np.int64)
    # Stable: rows of one frame keep their order.
    row[np.argsort(order, kind="stable")] = np.arange(count)
    kind, t_us = np.empty(count, np.int64), np.empty(count, np.int64)
    values = np.zeros((count, WIDTH))
    begin = 0
    for part in parts:
        to = row[begin : begin + len(part.order)]
        # The unused columns of a kind stay zero.
        kind[to], t_us[to] = part.kind, part.t_us
        values[to, : part.values.shape[1]] = part.values
        begin += len(to)
    others: dict[int, Sample] = {}
    for at, (_, sample) in zip(row[begin:].tolist(), beside, strict=True):
        kind[at], t_us[at], others[at] = KINDS[type(sample)], sample.t_us, sample
    return Block(kind, t_us, values, others)


class ImuRun(NamedTuple):
    """Consecutive IMU samples: timestamps (k,), rates in rad/s, specific force in m/s^2 (k, 6)."""

    t_us: Stamps
    values: Vector


class BlockSlice(NamedTuple):
    """The samples up to and including an event, which detectors process at once.

    `first` to `last` are the rows of `block`. `imu` are the samples of the IMUs with the sensor ids
    `ids` (k,); `id` is their common id, None if they differ. `mag` is the row of the last
    magnetometer sample, -1 if there is none; `kind` and `t_us` are those of the last row.
    """

    block: Block
    first: int
    last: int
    imu: ImuRun
    ids: Vector
    id: int | None
    mag: int
    kind: int
    t_us: int

    @property
    def event(self) -> Sample:
        """The last sample, the only one that may cause a decision."""
        return self.block.sample(self.last)

    def of_imu(self, number: int) -> ImuRun:
        """The samples of the IMU with id `number`."""
        if self.id == number:
            return self.imu
        mine = self.ids == number
        return ImuRun(self.imu.t_us[mine], self.imu.values[mine])


def split_at_events(samples: Sample | Block) -> Iterator[BlockSlice]:
    """Split a block, or a single sample, after each event."""
    block = block_of(samples)
    imu, ends, mags, cuts = _find_slices(block.kind)
    run = ImuRun(block.t_us[imu], block.values[imu, :IMU_ID])
    # A block nearly always comes from one IMU; then no rows need to be selected.
    ids = block.values[imu, IMU_ID]
    same = int(ids[0]) if len(ids) and (ids == ids[0]).all() else None
    columns = ends, mags, cuts, block.kind[ends], block.t_us[ends]
    first = a = 0
    for last, mag_row, b, kind, t_us in zip(*(c.tolist() for c in columns), strict=True):
        samples_of_imu = ImuRun(run.t_us[a:b], run.values[a:b])
        # A magnetometer sample before this slice belongs to an earlier one.
        newest = mag_row if mag_row >= first else -1
        yield BlockSlice(block, first, last, samples_of_imu, ids[a:b], same, newest, kind, t_us)
        first, a = last + 1, b


def _find_slices(kind: Indices) -> tuple[Indices, Indices, Indices, Indices]:
    """Rows of the IMU samples; and for each slice its last row, the row of the newest magnetometer
    sample (-1: none) and the number of IMU samples up to there."""
    count = len(kind)
    imu, mags = np.flatnonzero(kind == IMU), np.append(-1, np.flatnonzero(kind == MAG))
    ends = np.union1d(np.flatnonzero((kind >= FIX) & (kind < COMMAND)), np.arange(count)[-1:])
    newest = mags[np.searchsorted(mags, ends, "right") - 1]
    return imu, ends, newest, np.searchsorted(imu, ends, "right")

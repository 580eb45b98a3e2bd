"""Recordings -> samples in the order of their stamps: tlogs, and RINEX files with an IMU's CSV."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from analysis.recordings.flight_logs.autopilot_logs import is_autopilot_log, read_autopilot_log
from analysis.recordings.flight_logs.log_condition import LogCondition
from analysis.samples.block import IMU, Block, BlockPart, join_parts
from analysis.samples.decoder import MESSAGES, Decoder
from analysis.samples.sample import EphemerisSample, Epoch, IonosphereSample, Sample
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.numerics.constants import STANDARD_GRAVITY_MPS2
from mavproxy_fault.wire.tlog import read_ordered
from mavproxy_fault.wire.written import written_bytes

UNIX_TO_GPS_S = 315_964_800  # 1980-01-06 on Unix's count
WEEK_S = 604_800
NUMBER = re.compile(r"[+-]?\.?\d")  # how one begins


def read_log(path: Path | str, condition: LogCondition | None = None) -> Iterator[Block]:
    """What `Decoder` makes of a tlog, block by block; a ULog or dataflash log as one.

    What the log has lost goes into `condition`, of an autopilot's log before the block is given.

    Raises
    ------
    ConfigError
        If there is no such log, or it holds nothing to test.
    """
    if Path(path).is_file() and is_autopilot_log(Path(path)):
        yield read_autopilot_log(Path(path), condition)
        return
    decoder, junk = Decoder(), [0]
    sensed = False
    for columns, orders in read_ordered(path, MESSAGES, junk=junk):
        block = decoder.decode_columns(columns, orders)
        sensed |= len(block.kind) > 0
        yield block
    if not sensed:
        raise ConfigError(f"{path}: holds no message of a sensor; nothing in it can be tested")
    if condition is not None:
        condition.note_junk(junk[0], written_bytes(Path(path)))


def read_rinex(
    observations: Path,
    navigation: Path | Sequence[Path],
    imu: Path | None = None,
    lines: list[str] | None = None,
) -> Block:
    """A RINEX observation file with its navigation files, and IMU samples where there are any.

    A receiver's own log takes the place of the observation file, and of the navigation files where
    it has what the satellites sent. `lines` are those of the observation file where they were
    changed before they are read. The IMU file has one sample a line: GPS time on Unix's count of
    seconds, specific force (3) in g and rates (3) in rad/s, axes forward-left-up; further columns
    are passed over. `t_us` counts from the start of GPS time; what the navigation files hold comes
    first, stamped as the first.

    Raises
    ------
    ConfigError
        If a file cannot be read as what it should be, or does not fit the others.
    """
    from analysis.recordings.gnss.receiver_logs import is_receiver_log, read_receiver_log
    from analysis.recordings.gnss.rinex_navigation import read_navigation
    from analysis.recordings.gnss.rinex_observations import epochs_of, read_observations

    files = [navigation] if isinstance(navigation, Path) else list(navigation)
    broadcast: list[EphemerisSample | IonosphereSample] = []
    if is_receiver_log(observations):
        epochs, broadcast = read_receiver_log(observations)
    else:
        epochs = (
            read_observations(observations) if lines is None else epochs_of(observations, lines)
        )
    if not epochs:
        raise ConfigError(f"{observations}: has no epoch with a pseudorange that can be read")
    broadcast += [sample for path in files for sample in read_navigation(path)]
    _check_orbits(observations, files, epochs, broadcast)
    parts = [] if imu is None else [_read_imu(imu)]
    for part in parts:
        _check_overlap(imu, part, epochs)
    first_us = min([epoch.t_us for epoch in epochs] + [int(p.t_us.min()) for p in parts])
    beside: list[tuple[int, Sample]] = [(-1, replace(s, t_us=first_us)) for s in broadcast]
    # Twice the stamp, so that an IMU sample of the same instant fits in behind the epoch.
    beside += [(2 * epoch.t_us, epoch) for epoch in epochs]
    return join_parts(parts, beside)


def read_rinex_samples(
    observations: Path, navigation: Path | Sequence[Path], imu: Path | None = None
) -> list[Sample]:
    """What `read_rinex` reads, one sample after the other."""
    return list(read_rinex(observations, navigation, imu).samples())


def _check_orbits(
    observations: Path,
    files: Sequence[Path],
    epochs: Sequence[Epoch],
    broadcast: Sequence[EphemerisSample | IonosphereSample],
) -> None:
    """Refuse navigation files without an orbit that holds within the observations."""
    named = ", ".join(str(path) for path in files or [observations])
    orbits = [s.ephemeris for s in broadcast if isinstance(s, EphemerisSample)]
    if not orbits:
        # A receiver's own log may come without, if it was not asked for what the satellites sent.
        beside = "GPS, Galileo and others can" if files else "give a navigation file of that day"
        raise ConfigError(f"{named}: no ephemeris that can be read; {beside}")
    begin_s, end_s = (epochs[i].t_us * 1e-6 for i in (0, -1))
    if any(
        begin_s - orbit.fit_half_s <= orbit.week * WEEK_S + orbit.toe_s <= end_s + orbit.fit_half_s
        for orbit in orbits
    ):
        return
    toe_s = min((o.week * WEEK_S + o.toe_s for o in orbits), key=lambda t: abs(t - begin_s))
    raise ConfigError(
        f"{named}: its ephemerides are for {_date(toe_s)}, {observations} is of"
        f" {_date(begin_s)}; give the navigation file of that day"
    )


def _check_overlap(path: Path | None, part: BlockPart, epochs: Sequence[Epoch]) -> None:
    """Refuse IMU samples of another time than the observations."""
    begin_us, end_us = epochs[0].t_us, epochs[-1].t_us
    first_us, last_us = int(part.t_us.min()), int(part.t_us.max())
    if last_us < begin_us or first_us > end_us:
        raise ConfigError(
            f"{path}: is of {_date(first_us * 1e-6)} to {_date(last_us * 1e-6)}, the observations"
            f" are of {_date(begin_us * 1e-6)} to {_date(end_us * 1e-6)} GPS time; the first"
            " column is GPS time on Unix's count of seconds"
        )


def _date(gps_s: float) -> str:
    """A time of GPS's count of seconds for people."""
    moment = datetime.fromtimestamp(gps_s + UNIX_TO_GPS_S, UTC)
    return moment.strftime("%Y-%m-%d %H:%M:%S")


def _read_imu(path: Path) -> BlockPart:
    try:
        lines = path.read_text("utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read as text ({error})") from error
    headed = bool(lines) and not NUMBER.match(lines[0].split(",")[0].strip())
    samples = [line for line in lines[headed:] if line.strip()]
    if not samples:
        raise ConfigError(f"{path}: has no sample; a line is time, force (3) and rates (3)")
    try:
        table = np.loadtxt(samples, delimiter=",", ndmin=2)
    except ValueError as error:
        raise ConfigError(f"{path}: is no table of IMU samples ({error})") from error
    if table.shape[1] < 7:
        raise ConfigError(
            f"{path}: has {table.shape[1]} columns; GPS time on Unix's count in s, specific force"
            " (3) in g and rates (3) in rad/s, forward-left-up, are needed"
        )
    to_frd = np.array([1.0, -1.0, -1.0])
    t_us = np.rint((table[:, 0] - UNIX_TO_GPS_S) * 1e6).astype(np.int64)
    force = table[:, 1:4] * to_frd * STANDARD_GRAVITY_MPS2
    rates = table[:, 4:7] * to_frd
    return BlockPart(IMU, 2 * t_us + 1, t_us, np.hstack([rates, force]))  # behind an epoch's stamp

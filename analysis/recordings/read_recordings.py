"""Read recordings as blocks of samples: tlogs, autopilot logs, RINEX files with an IMU's CSV."""

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
from mavproxy_fault.wire.tlog import map_bytes, read_ordered
from mavproxy_fault.wire.written import written_bytes

UNIX_TO_GPS_S = 315_964_800  # Unix time of 1980-01-06
WEEK_S = 604_800
NUMBER = re.compile(r"[+-]?\.?\d")  # beginning of a number


def read_log(path: Path | str, condition: LogCondition | None = None) -> Iterator[Block]:
    """Read a log block by block.

    Lost parts are noted in `condition`; what an autopilot's logger lost before the first block.

    Raises
    ------
    ConfigError
        If the log does not exist or holds no sensor samples.
    """
    if Path(path).is_file() and is_autopilot_log(Path(path)):
        yield from read_autopilot_log(Path(path), condition or LogCondition())
        return
    decoder, junk = Decoder(), [0]
    sensed = False
    for columns, orders in read_ordered(map_bytes(Path(path)), MESSAGES, junk=junk):
        block = decoder.decode_columns(columns, orders)
        sensed |= len(block.kind) > 0
        yield block
    if not sensed:
        raise ConfigError(f"{path}: holds no sensor message; give a log with sensor data")
    if condition is not None:
        condition.note_junk(junk[0], written_bytes(Path(path)))


def read_rinex(
    observations: Path,
    navigation: Path | Sequence[Path],
    imu: Path | None = None,
    lines: list[str] | None = None,
) -> Block:
    """Read a RINEX observation file with its navigation files and optional IMU samples.

    A receiver log may replace the observation file, and the navigation files if it holds navigation
    messages. Beside navigation files, SP3 orbits and CLK clocks may be given. `lines` are the
    lines of the observation file if they were modified beforehand. The
    IMU file has one sample per line: GPS time in seconds since the Unix epoch, specific force (3)
    in g and angular rates (3) in rad/s, axes forward-left-up; further columns are ignored. `t_us`
    counts from the start of GPS time; ephemerides come first, with the timestamp of the first
    sample.

    Raises
    ------
    ConfigError
        If a file is not of the expected kind, or the files do not belong together.
    """
    from analysis.recordings.gnss.precise_files import NAMES, precise_samples, read_precise
    from analysis.recordings.gnss.receiver_logs import is_receiver_log, read_receiver_log
    from analysis.recordings.gnss.rinex_navigation import read_navigation
    from analysis.recordings.gnss.rinex_observations import read_observations

    files = [navigation] if isinstance(navigation, Path) else list(navigation)
    broadcast: list[EphemerisSample | IonosphereSample] = []
    if is_receiver_log(observations):
        epochs, broadcast = read_receiver_log(observations)
    else:
        epochs = read_observations(observations, lines)
    if not epochs:
        raise ConfigError(f"{observations}: no epoch has a readable pseudorange; give another file")
    precise = [path for path in files if NAMES.search(path.name)]
    plain = [path for path in files if path not in precise]
    broadcast += [sample for path in plain for sample in read_navigation(path)]
    _check_orbits(observations, plain, epochs, broadcast)
    if precise:
        orbits = [s.ephemeris for s in broadcast if isinstance(s, EphemerisSample)]
        begin_s, end_s = (epochs[i].t_us * 1e-6 for i in (0, -1))
        broadcast += precise_samples(read_precise(precise), orbits, begin_s, end_s)
    parts = [] if imu is None else [_read_imu(imu)]
    for part in parts:
        _check_overlap(imu, part, epochs)
    first_us = min([epoch.t_us for epoch in epochs] + [int(p.t_us.min()) for p in parts])
    beside: list[tuple[int, Sample]] = [(-1, replace(s, t_us=first_us)) for s in broadcast]
    # Twice the timestamp, so that an IMU sample of the same instant sorts after the epoch.
    beside += [(2 * epoch.t_us, epoch) for epoch in epochs]
    return join_parts(parts, beside)


def read_rinex_samples(
    observations: Path, navigation: Path | Sequence[Path], imu: Path | None = None
) -> list[Sample]:
    """Like `read_rinex`, but as a list of samples."""
    return list(read_rinex(observations, navigation, imu).samples())


def _check_orbits(
    observations: Path,
    files: Sequence[Path],
    epochs: Sequence[Epoch],
    broadcast: Sequence[EphemerisSample | IonosphereSample],
) -> None:
    """Raise ConfigError if no ephemeris is valid during the observations."""
    named = ", ".join(str(path) for path in files or [observations])
    orbits = [s.ephemeris for s in broadcast if isinstance(s, EphemerisSample)]
    if not orbits:
        # A receiver log has none if its navigation messages were not enabled.
        beside = "give one of a supported system" if files else "give a navigation file of that day"
        raise ConfigError(f"{named}: no readable ephemeris; {beside}")
    begin_s, end_s = (epochs[i].t_us * 1e-6 for i in (0, -1))
    if any(
        begin_s - orbit.fit_half_s <= orbit.week * WEEK_S + orbit.toe_s <= end_s + orbit.fit_half_s
        for orbit in orbits
    ):
        return
    toe_s = min((o.week * WEEK_S + o.toe_s for o in orbits), key=lambda t: abs(t - begin_s))
    raise ConfigError(
        f"{named}: its ephemerides are of {_date(toe_s)}, {observations} is of"
        f" {_date(begin_s)}; give the navigation file of that day"
    )


def _check_overlap(path: Path | None, part: BlockPart, epochs: Sequence[Epoch]) -> None:
    """Raise ConfigError if the IMU samples do not overlap the observations."""
    begin_us, end_us = epochs[0].t_us, epochs[-1].t_us
    first_us, last_us = int(part.t_us.min()), int(part.t_us.max())
    if last_us < begin_us or first_us > end_us:
        raise ConfigError(
            f"{path}: is of {_date(first_us * 1e-6)} to {_date(last_us * 1e-6)}, the observations"
            f" are of {_date(begin_us * 1e-6)} to {_date(end_us * 1e-6)} GPS time; the first"
            " column must be GPS time in seconds since the Unix epoch"
        )


def _date(gps_s: float) -> str:
    """Format a time in s since the start of GPS time."""
    date = datetime.fromtimestamp(gps_s + UNIX_TO_GPS_S, UTC)
    return date.strftime("%Y-%m-%d %H:%M:%S")


def _read_imu(path: Path) -> BlockPart:
    try:
        lines = path.read_text("utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read as text ({error})") from error
    headed = bool(lines) and not NUMBER.match(lines[0].split(",")[0].strip())
    samples = [line for line in lines[headed:] if line.strip()]
    if not samples:
        raise ConfigError(f"{path}: has no sample; each line needs time, force (3) and rates (3)")
    try:
        table = np.loadtxt(samples, delimiter=",", ndmin=2)
    except ValueError as error:
        raise ConfigError(f"{path}: is not a table of IMU samples ({error})") from error
    if table.shape[1] < 7:
        raise ConfigError(
            f"{path}: has {table.shape[1]} columns; GPS time in s on the Unix scale, specific force"
            " (3) in g and rates (3) in rad/s, forward-left-up, are needed"
        )
    to_frd = np.array([1.0, -1.0, -1.0])
    t_us = np.rint((table[:, 0] - UNIX_TO_GPS_S) * 1e6).astype(np.int64)
    force = table[:, 1:4] * to_frd * STANDARD_GRAVITY_MPS2
    rates = table[:, 4:7] * to_frd
    return BlockPart(IMU, 2 * t_us + 1, t_us, np.hstack([rates, force]))  # behind an epoch's stamp

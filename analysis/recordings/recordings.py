"""Recordings -> samples in the order of their stamps: tlogs, and RINEX files with an IMU's CSV."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from analysis.recordings.autopilot_logs import is_autopilot_log, read_autopilot_log
from analysis.samples.block import IMU, Block, Part, joined
from analysis.samples.decoder import MESSAGES, Decoder
from analysis.samples.sample import Sample
from mavproxy_fault.numerics.constants import STANDARD_GRAVITY_MPS2
from mavproxy_fault.wire.tlog import read_ordered

UNIX_TO_GPS_S = 315_964_800  # 1980-01-06 on Unix's count


def read_log(path: Path | str) -> Iterator[Block]:
    """What `Decoder` makes of a tlog, block by block; a ULog or dataflash log as one.

    Raises
    ------
    ConfigError
        If there is no such log, or it holds nothing to test.
    """
    if Path(path).is_file() and is_autopilot_log(Path(path)):
        yield read_autopilot_log(Path(path))
        return
    decoder = Decoder()
    for columns, orders in read_ordered(path, MESSAGES):
        yield decoder.columns(columns, orders)


def read_rinex(observations: Path, navigation: Path, imu: Path | None = None) -> Block:
    """A RINEX observation and navigation file, and IMU samples where there are any, by time.

    The IMU file has one sample a line: GPS time on Unix's count of seconds, specific force (3) in g
    and rates (3) in rad/s, axes forward-left-up; further columns are passed over. `t_us` counts
    from the start of GPS time; what the navigation file holds comes first, stamped as the first.

    Raises
    ------
    ConfigError
        If a file cannot be read as what it should be.
    """
    from analysis.recordings.rinex_navigation import read_navigation
    from analysis.recordings.rinex_observations import read_observations

    epochs = read_observations(observations)
    parts = [] if imu is None else [_read_imu(imu)]
    stamps = [epoch.t_us for epoch in epochs] + [int(p.t_us.min()) for p in parts if len(p.t_us)]
    first_us = min(stamps, default=0)
    broadcast = [replace(sample, t_us=first_us) for sample in read_navigation(navigation)]
    beside: list[tuple[int, Sample]] = [(-1, sample) for sample in broadcast]
    beside += [(2 * epoch.t_us, epoch) for epoch in epochs]
    return joined(parts, beside)


def read_rinex_samples(
    observations: Path, navigation: Path, imu: Path | None = None
) -> list[Sample]:
    """What `read_rinex` reads, one sample after the other."""
    return list(read_rinex(observations, navigation, imu).samples())


def _read_imu(path: Path) -> Part:
    from mavproxy_fault.documents.errors import ConfigError

    try:
        table = np.loadtxt(path, delimiter=",", ndmin=2)
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path}: is no table of IMU samples ({error})") from error
    if table.shape[1] < 7:
        raise ConfigError(
            f"{path}: has {table.shape[1]} columns; time, force (3) and rates (3) are needed"
        )
    to_frd = np.array([1.0, -1.0, -1.0])
    t_us = np.rint((table[:, 0] - UNIX_TO_GPS_S) * 1e6).astype(np.int64)
    force = table[:, 1:4] * to_frd * STANDARD_GRAVITY_MPS2
    rates = table[:, 4:7] * to_frd
    return Part(IMU, 2 * t_us + 1, t_us, np.hstack([rates, force]))  # behind an epoch's stamp

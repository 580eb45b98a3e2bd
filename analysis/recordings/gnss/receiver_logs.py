"""Read logs in receivers' formats: u-blox (also in autopilot logs), Septentrio, Android, RTCM 3."""

from pathlib import Path

from analysis.recordings.gnss.dataflash_ranges import is_dataflash_name, read_dataflash_ranges
from analysis.recordings.gnss.gnss_logger import is_gnss_logger, read_gnss_logger
from analysis.recordings.gnss.rtcm_file import is_rtcm, read_rtcm
from analysis.recordings.gnss.sbf_log import is_sbf, read_sbf
from analysis.recordings.gnss.ubx_log import is_ubx, read_ubx
from analysis.samples.sample import EphemerisSample, Epoch, IonosphereSample


def is_receiver_log(path: Path) -> bool:
    """Whether a file name is that of a receiver log or of an autopilot log that may hold one."""
    kinds = (is_ubx, is_sbf, is_rtcm, is_dataflash_name, is_gnss_logger)
    return any(is_kind(path) for is_kind in kinds)


def read_receiver_log(path: Path) -> tuple[list[Epoch], list[EphemerisSample | IonosphereSample]]:
    """Epochs of a receiver log; and its ephemerides and Klobuchar coefficients, with timestamp 0.

    Raises
    ------
    ConfigError
        If it cannot be read, or holds no pseudoranges.
    """
    if is_dataflash_name(path):
        return read_dataflash_ranges(path), []
    if is_gnss_logger(path):
        return read_gnss_logger(path), []
    if is_rtcm(path):
        return read_rtcm(path)
    return read_sbf(path) if is_sbf(path) else read_ubx(path)

"""Read logs in receivers' own formats: u-blox (also within autopilot logs), Septentrio, Android."""

from pathlib import Path

from analysis.recordings.gnss.dataflash_ranges import is_dataflash_name, read_dataflash_ranges
from analysis.recordings.gnss.gnss_logger import is_gnss_logger, read_gnss_logger
from analysis.recordings.gnss.sbf_log import is_sbf, read_sbf
from analysis.recordings.gnss.ubx_log import is_ubx, read_ubx
from analysis.samples.sample import EphemerisSample, Epoch, IonosphereSample


def is_receiver_log(path: Path) -> bool:
    """Whether a file name is that of a receiver log or of an autopilot log that may hold one."""
    return is_ubx(path) or is_sbf(path) or is_dataflash_name(path) or is_gnss_logger(path)


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
    return read_sbf(path) if is_sbf(path) else read_ubx(path)

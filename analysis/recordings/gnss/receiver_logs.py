"""What receivers log in their own formats: u-blox (also inside autopilots' logs), Septentrio."""

from pathlib import Path

from analysis.recordings.gnss.dataflash_ranges import is_dataflash_name, read_dataflash_ranges
from analysis.recordings.gnss.sbf_log import is_sbf, read_sbf
from analysis.recordings.gnss.ubx_log import is_ubx, read_ubx
from analysis.samples.sample import EphemerisSample, Epoch, IonosphereSample


def is_receiver_log(path: Path) -> bool:
    """Whether a file is named as a receiver's own log, or as an autopilot's that may hold one."""
    return is_ubx(path) or is_sbf(path) or is_dataflash_name(path)


def read_receiver_log(path: Path) -> tuple[list[Epoch], list[EphemerisSample | IonosphereSample]]:
    """Its epochs, and the ephemerides and Klobuchar's coefficients in it, stamped 0.

    Raises
    ------
    ConfigError
        If it cannot be read, or holds no pseudoranges.
    """
    if is_dataflash_name(path):
        return read_dataflash_ranges(path), []
    return read_sbf(path) if is_sbf(path) else read_ubx(path)

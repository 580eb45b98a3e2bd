"""What receivers log in their own formats: u-blox (also inside a PX4 log), Septentrio."""

from pathlib import Path

from analysis.recordings.sbf_log import is_sbf, read_sbf
from analysis.recordings.ubx_log import is_ubx, read_ubx
from analysis.samples.sample import EphemerisSample, Epoch, IonosphereSample


def is_receiver_log(path: Path) -> bool:
    """Whether a file is named as a receiver's own log."""
    return is_ubx(path) or is_sbf(path)


def read_receiver_log(path: Path) -> tuple[list[Epoch], list[EphemerisSample | IonosphereSample]]:
    """Its epochs, and the ephemerides and Klobuchar's coefficients in it, stamped 0.

    Raises
    ------
    ConfigError
        If it cannot be read, or holds no pseudoranges.
    """
    return read_sbf(path) if is_sbf(path) else read_ubx(path)

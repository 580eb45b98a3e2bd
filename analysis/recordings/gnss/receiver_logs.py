"""Read logs in receivers' formats: u-blox (also in autopilot logs), Septentrio, Android, RTCM 3."""

import re
from collections.abc import Callable
from pathlib import Path

from analysis.recordings.gnss.dataflash_ranges import read_dataflash_ranges
from analysis.recordings.gnss.gnss_logger import read_gnss_logger
from analysis.recordings.gnss.log_bytes import read_log_bytes
from analysis.recordings.gnss.sbf_log import read_sbf
from analysis.recordings.gnss.ubx_log import read_ubx
from analysis.samples.range_epochs import EpochAssembler
from analysis.samples.sample import EphemerisSample, Epoch, IonosphereSample
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.rtcm.ephemeris_messages import SYSTEMS
from mavproxy_fault.rtcm.transport import message_number, split_messages

Contents = tuple[list[Epoch], list[EphemerisSample | IonosphereSample]]


def read_rtcm(path: Path) -> Contents:
    """All epochs of a file of RTCM 3, and its ephemerides with timestamp 0.

    Raises
    ------
    ConfigError
        If the file cannot be read or holds no MSM7 of GPS or Galileo.
    """
    data = read_log_bytes(path, "a file of RTCM 3")
    messages = list(split_messages(data))
    # Ephemerides first: they give the week, which ranges lack.
    messages.sort(key=lambda message: message_number(message) not in SYSTEMS)
    samples = EpochAssembler().samples((i, message, None) for i, message in enumerate(messages))
    epochs = [sample for _, sample in samples if isinstance(sample, Epoch)]
    if not epochs:
        raise ConfigError(
            f"{path}: has no MSM7 of GPS or Galileo (1077, 1097); convert other messages to RINEX,"
            " for example with RTKLIB's convbin"
        )
    return epochs, [sample for _, sample in samples if isinstance(sample, EphemerisSample)]


# The ends of files' names: of u-blox, PX4, Septentrio (its own: SEPT078M.21_), RTCM, ArduPilot.
READERS: dict[str, Callable[[Path], Contents]] = {
    r"\.(ubx|ubx\.gz|ulg)": read_ubx,
    r"\.(sbf|\d\d_)(\.gz)?": read_sbf,
    r"\.rtcm3?(\.gz)?": read_rtcm,
    r"\.bin": lambda path: (read_dataflash_ranges(path), []),
    r"\.txt": lambda path: (read_gnss_logger(path), []),
}


def is_receiver_log(path: Path) -> bool:
    """Whether a file name is that of a receiver log or of an autopilot log that may hold one."""
    if path.suffix.lower() != ".txt":
        return _ending(path) is not None
    # A telephone's log; RINEX files are texts too.
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return b"RINEX VERSION" not in file.readline()


def read_receiver_log(path: Path) -> Contents:
    """Epochs of a receiver log; and its ephemerides and Klobuchar coefficients, with timestamp 0.

    Raises
    ------
    ConfigError
        If it cannot be read, or holds no pseudoranges.
    """
    return READERS[_ending(path) or ""](path)


def _ending(path: Path) -> str | None:
    name = path.name.lower()
    return next((ending for ending in READERS if re.search(f"{ending}$", name)), None)

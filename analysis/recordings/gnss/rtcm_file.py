"""Read files of RTCM 3: MSM7 of GPS and Galileo (1077, 1097) and their ephemerides (1019, 1046)."""

from pathlib import Path

from analysis.recordings.gnss.log_bytes import read_log_bytes
from analysis.samples.range_epochs import EpochAssembler
from analysis.samples.sample import EphemerisSample, Epoch, IonosphereSample
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.rtcm.ephemeris_messages import SYSTEMS
from mavproxy_fault.rtcm.transport import message_number, split_messages


def read_rtcm(path: Path) -> tuple[list[Epoch], list[EphemerisSample | IonosphereSample]]:
    """All epochs of a file, and its ephemerides with timestamp 0.

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

"""Labels: the ground truth of each fault, one JSON object per line in `labels.jsonl`."""

from collections.abc import Iterable, Iterator
from pathlib import Path

import msgspec

from mavproxy_fault.documents.errors import ConfigError


class Label(msgspec.Struct, frozen=True, omit_defaults=True, kw_only=True):
    """One activation of one fault.

    A label is written when the fault first changes a frame (`end_us` is None) and again when it
    ends; the last line with the same `id` and `start_us` is valid. Timestamps are microseconds of
    vehicle time, like those in the frames; the schedule's `at_s` counts from `t0_us`. `direction`
    is from-vehicle, to-vehicle, or both. If the fault's value is changed during the activation,
    a further line has the new value and its time. `clock` is "link" if times are of the link clock,
    which has the same origin; else they are vehicle time.
    """

    id: str
    fault: str
    preset: str | None = None
    targets: tuple[str, ...] = ()
    direction: str = ""
    t0_us: int
    start_us: int
    end_us: int | None = None
    frames: int = 0
    magnitude: float | None = None  # largest |after - before| in the field's unit
    saturated: int = 0
    where: dict[str, int | str] = {}
    parameters: dict[str, object] = {}
    seed: int = 0
    recorded: bool = False  # injected into a recording, so no vehicle could react
    value: float | None = None  # set by a live edit
    changed_us: int | None = None
    clock: str = ""
    by: str = ""  # "autopilot" if the vehicle itself failed the unit, at MAV_CMD_INJECT_FAILURE

    def describe_target(self) -> str:
        """What the fault changes: its targets, or in words what it changes without one."""
        whole = {"gps-spoof": "all positions", "command": "the vehicle"}
        return ", ".join(self.targets) or whole.get(self.fault, "the link")


def read_labels(path: Path) -> list[Label]:
    """Read the latest label of each activation, by start time; a truncated last line is ignored.

    Raises
    ------
    ConfigError
        If the file cannot be read or is not a label file.
    """
    if path.exists() and not path.is_file():  # a device may be endless
        raise ConfigError(f"{path}: is not a file; give a labels.jsonl")
    try:
        return latest_labels(_lines(path))
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}; give a labels.jsonl") from None
    except ValueError as error:  # includes msgspec's decode errors
        raise ConfigError(f"{path}: {error}; give a labels.jsonl") from None


def latest_labels(labels: Iterable[Label]) -> list[Label]:
    """Keep the latest label of every activation, sorted by start time."""
    last = {(label.id, label.start_us): label for label in labels}
    return sorted(last.values(), key=lambda label: (label.start_us, label.id))


def _lines(path: Path) -> Iterator[Label]:
    decoder = msgspec.json.Decoder(Label)
    for line in path.read_bytes().splitlines(keepends=True):
        try:
            yield decoder.decode(line)
        except msgspec.ValidationError:
            raise
        except msgspec.DecodeError:
            if line.endswith(b"\n"):
                raise

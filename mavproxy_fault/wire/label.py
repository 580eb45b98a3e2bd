"""Labels: what a fault really did, and when; one JSON object a line in `labels.jsonl`."""

from collections.abc import Iterable, Iterator
from pathlib import Path

import msgspec

from mavproxy_fault.documents.errors import ConfigError


class Label(msgspec.Struct, frozen=True, omit_defaults=True, kw_only=True):
    """One stretch in which one fault acted.

    A label is written when the fault first touches a frame (`end_us` is None) and again, complete,
    when it ends; the last line with the same `id` and `start_us` holds.
    Stamps are microseconds on the vehicle's clock, like the frames' own; `t0_us` is the stamp from
    which the schedule's `at_s` counts. `direction` is from-vehicle, to-vehicle, or both. Where the
    fault's value is changed while it acts, another line tells the new value and when it came.
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
    recorded: bool = False  # done to a recording: nobody could react
    value: float | None = None  # given live
    changed_us: int | None = None


def read_labels(path: Path) -> list[Label]:
    """The complete labels of a file, in order of their start; a cut last line is ignored.

    Raises
    ------
    ConfigError
        If the file cannot be read or holds something else.
    """
    if path.exists() and not path.is_file():  # a device may never end
        raise ConfigError(f"{path}: is not a file; give a labels.jsonl")
    try:
        return latest_labels(_lines(path))
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}; give a labels.jsonl") from None
    except ValueError as error:  # msgspec's decode errors are
        raise ConfigError(f"{path}: {error}; give a labels.jsonl") from None


def latest_labels(labels: Iterable[Label]) -> list[Label]:
    """The last word on every stretch, in order of start."""
    last = {(label.id, label.start_us): label for label in labels}
    return sorted(last.values(), key=lambda label: (label.start_us, label.id))


def _lines(path: Path) -> Iterator[Label]:
    decoder = msgspec.json.Decoder(Label)
    for line in path.read_bytes().splitlines(keepends=True):
        if line.endswith(b"\n"):
            yield decoder.decode(line)

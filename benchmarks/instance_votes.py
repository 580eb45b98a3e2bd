"""Whether the faulty one of several sensors of a kind is isolated, on recordings with several.

    python benchmarks/instance_votes.py LOG...

Each sensor of each kind gets a bias in turn, for ten seconds from the middle of the log on. Prints
a row for each bias: how often the sensor was isolated, the pair named, the bias missed, or another
sensor isolated, and how many logs have an alarm without any bias.
"""

import argparse
from collections import Counter
from pathlib import Path

import numpy as np

from analysis.detection.sensors.instance_vote import VOTERS, InstanceVoteDetector, VoterKind
from analysis.recordings.read_recordings import read_log
from analysis.samples.block import (
    BARO,
    FIX,
    IMU,
    IMU_ID,
    MAG,
    SPARE,
    SPARE_ID,
    SPARE_KIND,
    SPARE_NUMBERS,
    Block,
)
from mavproxy_fault.documents.errors import ConfigError

RESULTS = ("isolated", "pair named", "missed", "another isolated")
FOR_US, AFTER_US = 10_000_000, 3_000_000
# kind, text, first biased value, bias
BIASES = (
    (IMU, "gyro, 0.2 rad/s", 0, 0.2),
    (IMU, "accelerometer, 2 m/s^2", 3, 2.0),
    (MAG, "magnetometer, 0.2 gauss", 0, 0.2),
    (BARO, "barometer, 100 Pa", 0, 100.0),
    (FIX, "receiver, 50 m north", 0, 50.0 / 111_195.0),
)


def main() -> None:
    """Try every bias on every log."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("logs", nargs="+", type=Path)
    blocks = [block for path in parser.parse_args().logs if (block := read(path)) is not None]
    print(
        "| bias | sensors | isolated | pair named | missed | another isolated | alarms without it |"
    )
    print("|---|---|---|---|---|---|---|")
    for kind, text, first, bias in BIASES:
        voters = next(voters for voters in VOTERS if voters.kind == kind)
        for count in (2, 3):
            several = [block for block in blocks if len(instances(block, kind)) == count]
            if several:
                clean = sum(bool(reasons(block, voters)) for block in several)
                found = Counter(
                    outcome(block, voters, number, first, bias)
                    for block in several
                    for number in instances(block, kind)
                )
                row = (
                    found[result]
                    for result in ("isolated", "pair named", "missed", "another isolated")
                )
                print(f"| {text} | {count} | {' | '.join(map(str, row))} | {clean} |", flush=True)


def read(path: Path) -> Block | None:
    """The samples of a log; None, and why, if there are too few."""
    try:
        (block,) = read_log(path)
    except ConfigError as error:
        print(error)
        return None
    return block


def of(block: Block, kind: int, number: int) -> tuple[np.ndarray, int]:
    """The rows of one sensor, and the column of its first number."""
    if kind == IMU:
        return np.flatnonzero((block.kind == IMU) & (block.values[:, IMU_ID] == number)), 0
    if number == 0:
        return block.rows(kind), 0
    rows = block.rows(SPARE)
    mine = (block.values[rows, SPARE_KIND] == kind) & (block.values[rows, SPARE_ID] == number)
    return rows[mine], SPARE_NUMBERS


def instances(block: Block, kind: int) -> list[int]:
    """The sensors of a kind that have samples."""
    return [number for number in range(3) if len(of(block, kind, number)[0])]


def reasons(block: Block, voters: VoterKind) -> list[tuple[int, str]]:
    """Times and reasons of the alarms about a kind."""
    vote = InstanceVoteDetector()
    found, _ = vote.step(block, vote.new_state())
    return [(result.t_us, result.reason) for _, result in found if result.sensor == voters.sensor]


def outcome(block: Block, voters: VoterKind, number: int, first: int, bias: float) -> str:
    """The result of the vote for a bias on one sensor."""
    begin_us = int(np.median(block.t_us))
    rows, column = of(block, voters.kind, number)
    wrong = rows[(block.t_us[rows] >= begin_us) & (block.t_us[rows] < begin_us + FOR_US)]
    values = block.values.copy()
    values[wrong, column + first] += bias
    alarms = reasons(block._replace(values=values), voters)
    last_us = begin_us + FOR_US + AFTER_US
    during = {reason for t_us, reason in alarms if begin_us <= t_us <= last_us}
    name = f"{voters.name} {number + 1}"
    if any("disagrees" in reason and not reason.startswith(name) for reason in during):
        return "another isolated"
    if any(reason.startswith(f"{name} disagrees") for reason in during):
        return "isolated"
    return "pair named" if during else "missed"


if __name__ == "__main__":
    main()

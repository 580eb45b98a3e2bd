"""Every kind of input file, broken at random: it is read, or refused with its line.

`MUTANTS=1000 pytest tests/analysis/run/test_mutated_documents.py` is the long form.
"""

import os
import random
import re
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest

from analysis.campaign.campaign_command import describe_size, estimate_size
from analysis.campaign.campaign_file import read_campaign
from analysis.campaign.campaign_plan import CampaignPlan
from analysis.report.judging.check_limits import Thresholds, read_thresholds
from analysis.run.run_setup import read_setup
from analysis.search.space.test_file import read_test
from mavproxy_fault.documents.errors import ConfigError
from mavproxy_fault.documents.yaml_document import write_yaml
from mavproxy_fault.live.rflysim import DEFAULT_MAP, read_map
from mavproxy_fault.schedule.entries import read_schedule
from simvehicle.scenario.scenario_file import read_scenario
from simvehicle.vehicles.fixedwing.fixedwing_parameters import FixedWingParameters
from simvehicle.vehicles.parameter_file import read_parameters

ROOT = Path(__file__).parents[3]
MUTANTS = int(os.environ.get("MUTANTS", "60"))  # of each kind of file
SLOWEST_S = 2.0  # of processor time, to read or refuse one

HOSTILE = [
    ".inf", "-.inf", ".nan", "1e300", "-1", "0", "1e-300", "''", "[]", "{}", "null", "true", "010",
    "1:30", "[[[1]]]", "{a: {b: 1}}", "9" * 30, "9" * 5000, "&a [*a]", "!!binary x", "'\\0'", "*x",
    "PSEUDORANGE.G12", "PLANT.x", "a" * 500, "2.5", "[1, 2]", "{uniform: [1, 0]}", "- x", "\t",
]  # fmt: skip
SCALAR = re.compile(r"(?<=[:\[,] )[^\s,\[\]{}]+")


def mutated(text: str, rng: random.Random) -> str:
    """Return a text with one to three random errors."""
    for _ in range(rng.randint(1, 3)):
        lines = text.splitlines()
        at = rng.randrange(len(lines))
        kind = rng.randrange(6)
        scalars = list(SCALAR.finditer(text))
        if kind <= 2 and scalars:
            found = rng.choice(scalars)
            text = text[: found.start()] + rng.choice(HOSTILE) + text[found.end() :]
            continue
        if kind == 3:
            lines.insert(at, lines[rng.randrange(len(lines))])
        elif kind == 4:
            del lines[at]
        else:
            lines[at] = rng.choice([" ", "- ", "? ", ": ", "%", "\x07", "é"]) + lines[at]
        text = "\n".join(lines) + "\n" if lines else "a: 1\n"
    return text


def parameters(path: Path) -> object:
    return read_parameters(path, FixedWingParameters)


def dry_run(path: Path) -> object:
    """Do what `campaign --dry-run` does with a file."""
    return describe_size(estimate_size(CampaignPlan(read_campaign(path), None), 2))


def campaign(path: Path) -> str:
    """Return a campaign whose scenarios have absolute paths."""
    return re.sub(r"(?<=[\[ ])(?=\w+\.yaml)", f"{path.parent}/", path.read_text())


DEMO = ROOT / "simvehicle/scenario/demo.yaml"
KINDS: list[tuple[Callable[[Path], object], Path | str]] = [
    (lambda path: read_setup(str(path)), DEMO),
    (read_scenario, DEMO),
    (lambda path: read_thresholds(str(path)), write_yaml({k: list(v) if isinstance(v, tuple) else v
        for k in Thresholds.__struct_fields__ for v in [getattr(Thresholds(), k)]})),
    (read_map, DEFAULT_MAP),
    (parameters, ROOT / "simvehicle/vehicles/parameters/aerosonde-2025.yaml"),
    *((read_test, path) for path in sorted((ROOT / "examples").glob("*search*.yaml"))[:2]),
    *((dry_run, campaign(path)) for path in sorted((ROOT / "examples").glob("campaign_*.yaml"))),
    *((read_schedule, path) for path in sorted((ROOT / "examples").glob("*.yaml"))
      if path.read_text().startswith(("seed", "faults")) or "\nfaults:" in path.read_text()),
]  # fmt: skip


@pytest.mark.parametrize(("read", "source"), KINDS)
def test_a_broken_file_is_read_or_refused_with_its_name(
    read: Callable[[Path], object], source: Path | str, tmp_path: Path
) -> None:
    text = source.read_text() if isinstance(source, Path) else source
    rng = random.Random(7)
    errors = []
    complete = tmp_path / "complete.yaml"
    complete.write_text(text, encoding="utf-8")
    with suppress(ConfigError):  # some refer to other files
        read(complete)  # the measured time excludes imports and compilation in the first call
    for number in range(MUTANTS):
        path = tmp_path / f"{number}.yaml"
        path.write_text(mutated(text, rng), encoding="utf-8")
        began = time.thread_time()
        try:
            read(path)
        except ConfigError as error:
            errors.append(str(error))
        assert time.thread_time() - began < SLOWEST_S, path.read_text()
    assert len(errors) > MUTANTS // 4
    nameless = [text for text in errors if str(tmp_path) not in text and "vehicle." not in text]
    assert nameless == []

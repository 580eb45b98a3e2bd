"""A flight has the same bytes on other processors: libraries choose their code by processor."""

import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = """
import sys
from hashlib import sha256
from simvehicle.scenario.scenario_file import read_scenario
from simvehicle.simulation.simulation import Simulation

for path in sys.argv[1:]:
    simulation, digest = Simulation(read_scenario(path or None)), sha256()
    for _ in range(1000):
        simulation.step()
        digest.update(simulation.board.flight.tobytes() + simulation.board.sensors.tobytes())
    print(digest.hexdigest())
"""
SCENARIOS = ["", str(Path(__file__).parents[3] / "examples" / "quad_mission.yaml")]
# Without AVX: OpenBLAS's kernels for Nehalem and numpy's baseline.
OLD = {"OPENBLAS_CORETYPE": "Nehalem", "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4"}


@pytest.mark.skipif(platform.machine() != "x86_64", reason="chooses code of x86 processors")
def test_a_flight_has_the_same_bytes_on_an_old_processor() -> None:
    hashes = [
        subprocess.run(
            [sys.executable, "-W", "ignore", "-c", SCRIPT, *SCENARIOS],
            env={**os.environ, **changes},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for changes in ({}, OLD)
    ]
    assert hashes[0] == hashes[1]
    assert len(hashes[0].split()) == len(SCENARIOS)

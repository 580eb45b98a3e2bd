"""What the tests share: the folder of real logs and GNSS data, and Hypothesis profiles."""

import os
from pathlib import Path

import pytest
from hypothesis import settings

DATA = Path(
    os.environ.get("MAVPROXY_FAULT_DATA", Path(__file__).resolve().parents[2] / "shared" / "data")
)

settings.register_profile("fast", max_examples=60, deadline=None, derandomize=True)
settings.register_profile("deep", max_examples=5000, deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "fast"))


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real logs; the test is skipped where it is absent."""
    if not DATA.is_dir():
        pytest.skip(f"no real logs at {DATA}; set MAVPROXY_FAULT_DATA")
    return DATA

"""An autopilot in the loop, behind a MAVLink link: a stand-in process in lockstep."""

import sys
from pathlib import Path

import numpy as np
import pytest

from analysis.search.evaluation.flown_cases import Flown
from analysis.search.space.fault_range import FaultRange
from analysis.search.space.test_file import AutopilotChoice, Initial, Sensors, TestFile
from mavproxy_fault.documents.errors import ConfigError

STAND_IN = Path(__file__).with_name("stand_in.py")
CHOICE = AutopilotChoice(
    link="tcpin:127.0.0.1:0", command=[sys.executable, str(STAND_IN), "{port}"]
)
FAULT = FaultRange(fault="bias", target="HIL_SENSOR.xgyro", value=(0.0, 0.1), at_s=1.0, for_s=2.0)
TEST = TestFile(
    estimator="autopilot",
    autopilot=CHOICE,
    duration_s=5.0,
    noise_draws=1,
    initial=Initial(height_m=1000.0),
    sensors=Sensors(gyro_sigma_dps=0.01),
    faults=[FAULT],
)


def test_an_autopilot_is_searched_in_lockstep():
    flown = Flown(TEST)
    assert flown.space.names == ("faults[0].value",)
    outcome = flown.evaluate(np.array([[0.0], [1.0]]), 1, 0)
    assert (outcome.broken_limit == 0).all()
    assert outcome.fitness[0] < 0.2
    # 0.1 rad/s for 2 s is 11.5 degrees, held for the last 2 s and rising before
    held = np.degrees(0.2)
    expected = held * np.sqrt((2.0 / 3.0 + 2.0) / 5.0)
    assert outcome.rmse_deg[1, 0] == pytest.approx(expected, rel=0.02)


def test_an_autopilot_that_does_not_start_is_the_users_error():
    choice = AutopilotChoice(link="tcpin:127.0.0.1:0", command=["no-such-autopilot"])
    test = TestFile(estimator="autopilot", autopilot=choice)
    with pytest.raises(
        ConfigError, match=r"autopilot.command: no-such-autopilot cannot be started"
    ):
        Flown(test).evaluate(np.zeros((1, 0)), 1, 0)


def test_an_autopilot_that_ends_at_once_is_the_users_error():
    choice = AutopilotChoice(link="tcpin:127.0.0.1:0", command=[sys.executable, "-c", ""])
    test = TestFile(estimator="autopilot", autopilot=choice)
    with pytest.raises(ConfigError, match="it ended with code 0"):
        Flown(test).evaluate(np.zeros((1, 0)), 1, 0)

"""A flight for the page: truth, sensors and estimate over time, path and parameters."""

import math
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from analysis.search.search_session import SearchSession
from analysis.search.shrink import pin_values
from analysis.search.space.airframe import has_rotors
from mavproxy_fault.numerics.rotations.rotation import euler_from_quat

MAX_SAMPLES = 12_000  # samples sent to the page; longer flights are thinned
DIGITS = 5  # decimal places
Array = NDArray[np.float64]


def flight_data(session: SearchSession) -> bytes:
    """The displayed flight as JSON."""
    trace = session.trace
    assert trace is not None
    step, state = math.ceil(len(trace.truth) / MAX_SAMPLES), trace.truth
    # Unwrapped, so that a heading through north draws no vertical line.
    truth = np.degrees(np.unwrap(euler_from_quat(state[:, 6:10]), axis=0))
    error = np.degrees(trace.error_rad)
    begin = state[0, :3]
    columns = {
        "t": trace.t_s[:, None],
        "truth": truth,
        # Truth plus error: the estimate stays close to the unwrapped truth.
        "estimate": truth + error[:, :3],
        "error": error[:, :3],
        "gyro": np.degrees(trace.imu[:, :3]),
        "accel": trace.imu[:, 3:],
        "path": np.column_stack([state[:, 1], state[:, 0], -state[:, 2]])
        - [begin[1], begin[0], -begin[2]],
        "q": state[:, 6:10],
        "believed": trace.q_nb,
    }
    flight: dict[str, Any] = {
        name: rounded_columns(values[::step]) for name, values in columns.items()
    }
    return msgspec.json.encode(
        {
            **flight,
            "number": session.number,
            "title": session.title,
            "rotors": has_rotors(session.test.vehicle),
            "step": step,
            "parameters": parameters_of(session),
            "faults": [
                {"what": f"{one.fault} on {one.target}", "at_s": one.at_s, "for_s": one.for_s}
                for one in pin_values(session.test, session.values).faults
            ],
        }
    )


def rounded_columns(values: Array) -> list[list[float]]:
    """The columns of (n, k) as lists of rounded numbers."""
    return np.round(values.T, DIGITS).tolist()  # type: ignore[no-any-return]


def parameters_of(session: SearchSession) -> list[dict[str, Any]]:
    """Each searched value with its range; a target by its name."""
    faults = pin_values(session.test, session.values).faults
    parameters = []
    for name, (low, high) in session.ranges().items():
        value: float | str = session.values[name]
        section, _, key = name.partition("].")
        if key == "target":
            value = faults[int(section.removeprefix("faults["))].target or ""
        parameters.append({"name": name, "value": value, "low": low, "high": high})
    return parameters

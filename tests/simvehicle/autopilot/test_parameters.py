import struct
from typing import Any

import pytest


def bits_of(value: int) -> float:
    return float(struct.unpack("<f", struct.pack("<i", value))[0])


def test_the_parameter_list_is_complete_and_numbered(station: Any) -> None:
    values = station.send("param_request_list", 1, 1)
    assert [v.param_index for v in values] == list(range(len(values)))
    assert {v.param_count for v in values} == {len(values)}
    assert [v.param_id for v in values] == sorted(v.param_id for v in values)


def test_an_integer_is_sent_bytewise(station: Any) -> None:
    (before,) = station.send("param_request_read", 1, 1, b"SYS_FAILURE_EN", -1)
    assert (before.param_type, before.param_value) == (6, 0.0)
    (after,) = station.send("param_set", 1, 1, b"SYS_FAILURE_EN", bits_of(1), 6)
    assert after.param_value == bits_of(1)
    assert station.parameters["SYS_FAILURE_EN"] == 1


def test_a_float_is_set_and_read_by_index(station: Any) -> None:
    (after,) = station.send("param_set", 1, 1, b"MIS_TAKEOFF_ALT", 25.5, 9)
    assert after.param_value == 25.5
    (again,) = station.send("param_request_read", 1, 1, b"", after.param_index)
    assert (again.param_id, again.param_value) == ("MIS_TAKEOFF_ALT", 25.5)


@pytest.mark.parametrize(("value", "kind"), [(3.0, 6), (float("nan"), 9)])
def test_a_value_of_the_wrong_type_is_answered_with_the_old_value(
    station: Any, value: float, kind: int
) -> None:
    (after,) = station.send("param_set", 1, 1, b"MIS_TAKEOFF_ALT", value, kind)
    assert after.param_value == 10.0


def test_unknown_names_get_no_answer(station: Any) -> None:
    assert station.send("param_request_read", 1, 1, b"NO_SUCH", -1) == []
    assert station.send("param_request_read", 1, 1, b"", 30000) == []
    assert station.send("param_set", 1, 1, b"NO_SUCH", 1.0, 9) == []

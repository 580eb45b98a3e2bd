import math
from typing import Any

import pytest
from pymavlink.dialects.v20 import all as dialect

SQUARE = [(22, 0, 0, 10), (16, 30, 0, 10), (16, 30, 30, 12), (21, 0, 0, 0)]


def test_what_was_uploaded_is_downloaded(station: Any, upload: Any) -> None:
    assert upload(SQUARE) == dialect.MAV_MISSION_ACCEPTED
    (count,) = station.send("mission_request_list", 1, 1, 0)
    assert (count.count, count.target_system) == (4, 255)
    items = [station.send("mission_request_int", 1, 1, seq, 0)[0] for seq in range(4)]
    assert [(i.command, i.z) for i in items] == [(22, 10), (16, 10), (16, 12), (21, 0)]
    (old,) = station.send("mission_request", 1, 1, 1, 0)
    assert old.get_type() == "MISSION_ITEM"
    assert old.x == pytest.approx(items[1].x * 1e-7, abs=1e-5)


def test_a_lost_item_is_requested_again_until_the_upload_is_cancelled(station: Any) -> None:
    station.send("mission_count", 1, 1, 2, 0)
    said = [
        m
        for _ in range(60)
        for m in station.at([0, 0, 0], 0.1)
        if m.get_type() in ("MISSION_REQUEST_INT", "MISSION_ACK")
    ]
    assert [m.get_type() for m in said] == ["MISSION_REQUEST_INT"] * 6 + ["MISSION_ACK"]
    assert said[-1].type == dialect.MAV_MISSION_OPERATION_CANCELLED


def test_an_item_that_cannot_be_flown_ends_the_upload(station: Any, upload: Any) -> None:
    assert upload([(2000, 0, 0, 0)]) == dialect.MAV_MISSION_UNSUPPORTED
    assert station.missions.items == ()


def test_a_place_off_the_earth_is_refused(station: Any) -> None:
    station.send("mission_count", 1, 1, 1, 0)
    (ack,) = station.send(
        "mission_item_int", 1, 1, 0, 6, 16, 0, 1, 0, 0, 0, math.nan, 950_000_000, 0, 10, 0
    )
    assert ack.type == dialect.MAV_MISSION_INVALID_PARAM5_X


@pytest.mark.parametrize("kind", [1, 2])
def test_fences_and_rally_points_are_refused(station: Any, kind: int) -> None:
    (count,) = station.send("mission_request_list", 1, 1, kind)
    assert (count.count, count.mission_type) == (0, kind)
    (ack,) = station.send("mission_count", 1, 1, 3, kind)
    assert (ack.type, ack.mission_type) == (dialect.MAV_MISSION_UNSUPPORTED, kind)
    (ack,) = station.send("mission_clear_all", 1, 1, kind)
    assert ack.type == dialect.MAV_MISSION_ACCEPTED


def test_a_mission_is_cleared(station: Any, upload: Any) -> None:
    upload(SQUARE)
    (ack,) = station.send("mission_clear_all", 1, 1, 0)
    assert ack.type == dialect.MAV_MISSION_ACCEPTED
    assert station.send("mission_request_list", 1, 1, 0)[0].count == 0


def test_a_repeated_item_changes_nothing(station: Any) -> None:
    station.send("mission_count", 1, 1, 2, 0)
    item = (1, 1, 0, 6, 16, 0, 1, 0, 0, 0, math.nan, 470_000_000, 80_000_000, 10, 0)
    (ask,) = station.send("mission_item_int", *item)
    assert ask.seq == 1
    assert station.send("mission_item_int", *item) == []

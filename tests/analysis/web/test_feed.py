import json

import pytest

from analysis.web.feed import MAX_QUEUED_BATCHES, MAX_VIEWERS, SAMPLES_PER_TICK, Feed, Viewer
from mavproxy_fault.documents.errors import ConfigError


def said(viewer: Viewer) -> list[list[object]]:
    """All samples that wait for a viewer, in order."""
    samples: list[list[object]] = []
    while not viewer.queue.empty():
        samples += json.loads(viewer.queue.get_nowait())
    return samples


def test_a_tick_carries_the_newest_state_and_every_event() -> None:
    feed = Feed()
    viewer = feed.add_viewer()
    said(viewer)
    for number in range(5):
        feed.add_sample("schedule/state", b"%d" % number)
        feed.add_sample("fdi/events", b"%d" % number)
    feed.tick()
    feed.tick()
    assert said(viewer) == [["schedule/state", 4], *(["fdi/events", n] for n in range(5))]


def test_a_frozen_viewer_holds_a_bounded_queue_and_no_other_viewer() -> None:
    feed = Feed()
    frozen, lively = feed.add_viewer(), feed.add_viewer()
    said(lively)
    for number in range(3 * MAX_QUEUED_BATCHES):
        feed.add_sample("fdi/main/stat", b"%d" % number)
        feed.tick()
        assert said(lively) == [["fdi/main/stat", number]]
    assert frozen.queue.qsize() <= MAX_QUEUED_BATCHES


def test_a_viewer_that_lags_gets_a_new_snapshot() -> None:
    feed = Feed()
    viewer = feed.add_viewer()
    feed.add_sample("fdi/events", b'"early"')
    for number in range(MAX_QUEUED_BATCHES):
        feed.add_sample("schedule/state", b"%d" % number)
        feed.tick()
    assert said(viewer) == [
        ["page/picture", None],
        ["schedule/state", MAX_QUEUED_BATCHES - 1],
        ["fdi/events", "early"],
    ]


def test_a_late_joiner_gets_the_events_and_the_newest_samples() -> None:
    feed = Feed()
    feed.add_sample("proxy/labels", b"1")
    feed.add_sample("schedule/state", b"2")
    feed.tick()
    assert said(feed.add_viewer()) == [
        ["page/picture", None],
        ["schedule/state", 2],
        ["proxy/labels", 1],
    ]


def test_a_sample_that_is_no_json_does_not_spoil_the_batch() -> None:
    feed = Feed()
    viewer = feed.add_viewer()
    said(viewer)
    feed.add_sample("fdi/main/stat", b"{nonsense")
    feed.add_sample("att/ekf/score", b"3")
    feed.tick()
    assert said(viewer) == [["att/ekf/score", 3]]


def test_a_burst_of_a_curve_is_complete_up_to_a_bound() -> None:
    feed = Feed()
    viewer = feed.add_viewer()
    said(viewer)
    for number in range(2 * SAMPLES_PER_TICK):
        feed.add_sample("fdi/main/stat", b"%d" % number)
    feed.tick()
    assert said(viewer) == [
        ["fdi/main/stat", number] for number in range(SAMPLES_PER_TICK, 2 * SAMPLES_PER_TICK)
    ]


def test_a_late_joiner_is_shown_the_past_of_a_curve() -> None:
    feed = Feed()
    for number in range(3):
        feed.add_sample("fdi/main/stat", b"%d" % number)
        feed.tick()
    assert said(feed.add_viewer())[1:] == [["fdi/main/stat", number] for number in range(3)]


def test_existing_messages_of_all_viewers_are_requested() -> None:
    feed = Feed()
    one, other = feed.add_viewer(), feed.add_viewer()
    one.request_messages('["HIL_GPS", "NO_SUCH_MESSAGE"]')
    other.request_messages('["ATTITUDE", "HIL_GPS"]')
    other.request_messages("{")
    assert feed.requested_messages() == ["ATTITUDE", "HIL_GPS"]
    feed.remove_viewer(other)
    assert feed.requested_messages() == ["HIL_GPS"]


def test_too_many_viewers_are_refused() -> None:
    feed = Feed()
    for _ in range(MAX_VIEWERS):
        feed.add_viewer()
    with pytest.raises(ConfigError, match="the page already has"):
        feed.add_viewer()

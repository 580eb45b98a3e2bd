"""Results on the bus."""

import queue

import msgspec

from analysis.monitor.publish import Publisher
from analysis.results import Decision, decode
from mavproxy_fault.links.bus import open_bus


def decision(t_s: float, excluded: tuple[str, ...] = ()) -> Decision:
    return Decision(
        t_s=t_s,
        t_us=int(t_s * 1e6),
        statistic=3.0,
        threshold=25.0,
        dof=6,
        p_value=0.8,
        alarm=bool(excluded),
        hypothesis="satellites" if excluded else "none",
        excluded=excluded,
    )


def test_every_decision_is_published_and_only_changes_are_events() -> None:
    decisions = [decision(0.0), decision(0.2), decision(0.4, ("G12",)), decision(0.6, ("G12",))]
    with open_bus("tcp/127.0.0.1:0", run="t", router=True) as bus:
        got: queue.Queue[tuple[str, bytes]] = queue.Queue(20)
        bus.subscribe("fdi/*/stat", lambda key, data: got.put((key, data)))
        bus.subscribe("fdi/events", lambda key, data: got.put((key, data)))
        Publisher(bus).publish(decisions)
        seen = [got.get(timeout=5) for _ in range(6)]
    stats = [decode(data) for key, data in seen if key.endswith("main/stat")]
    events = [decode(data) for key, data in seen if key.endswith("fdi/events")]
    assert stats == decisions
    assert events == [decisions[0], decisions[2]]


def test_isolation_is_told_when_the_excluded_change_and_not_with_every_verdict() -> None:
    alarmed = msgspec.structs.replace(decision(0.2), alarm=True, hypothesis="multiple-unknown")
    decisions = [decision(0.0), alarmed, decision(0.4, ("G12",)), decision(0.6, ("E05", "G12"))]
    with open_bus("tcp/127.0.0.1:0", run="t", router=True) as bus:
        got: queue.Queue[bytes] = queue.Queue(20)
        bus.subscribe("fdi/isolation", lambda _, data: got.put(data))
        Publisher(bus).publish(decisions)
        told = [got.get(timeout=5) for _ in range(3)]  # one of each verdict would be another
    assert [decode(data) for data in told] == [decisions[0], *decisions[2:]]

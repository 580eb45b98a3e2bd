"""Results on the bus."""

import json
import queue
from pathlib import Path

import msgspec

from analysis.monitor.publish import Publisher
from analysis.results import AttitudeError, Decision, FusedState, SensorDecision, decode
from mavproxy_fault.links.bus import open_bus


def decision(t_s: float, excluded: tuple[str, ...] = ()) -> Decision:
    return Decision(
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


def test_a_sensor_that_cannot_be_tested_between_alarms_is_no_event() -> None:
    alarm = SensorDecision(t_us=1, sensor="mag", alarm=True, isolated=True)
    untested = SensorDecision(t_us=2, sensor="mag", reason="no healthy reference")
    results = [alarm, untested, msgspec.structs.replace(alarm, t_us=3), decision(0.2)]
    with open_bus("tcp/127.0.0.1:0", run="t", router=True) as bus:
        got: queue.Queue[bytes] = queue.Queue(20)
        bus.subscribe("fdi/events", lambda _, data: got.put(data))
        Publisher(bus).publish(results)
        assert [decode(got.get(timeout=5)) for _ in range(2)] == [alarm, decision(0.2)]


def test_isolation_is_published_when_exclusions_change_and_not_with_every_verdict() -> None:
    alarmed = msgspec.structs.replace(decision(0.2), alarm=True, hypothesis="multiple-unknown")
    decisions = [decision(0.0), alarmed, decision(0.4, ("G12",)), decision(0.6, ("E05", "G12"))]
    with open_bus("tcp/127.0.0.1:0", run="t", router=True) as bus:
        got: queue.Queue[bytes] = queue.Queue(20)
        bus.subscribe("fdi/isolation", lambda _, data: got.put(data))
        Publisher(bus).publish(decisions)
        events = [got.get(timeout=5) for _ in range(3)]  # one of each verdict would be another
    assert [decode(data) for data in events] == [decisions[0], *decisions[2:]]


def test_every_key_that_is_published_has_a_schema_and_none_is_listed_in_vain() -> None:
    zeros: tuple[float, float, float] = (0.0, 0.0, 0.0)
    fused = FusedState(
        t_us=1, position_ecef_m=zeros, velocity_ned_mps=zeros, q_nb=(1.0, 0.0, 0.0, 0.0),
        position_sigma_m=zeros, velocity_sigma_mps=zeros, attitude_sigma_deg=zeros,
    )  # fmt: skip
    results = [
        decision(0.0, ("G12",)),
        SensorDecision(t_us=1, sensor="{sensor}", statistic=1.0, threshold=2.0, dof=1, alarm=True),
        AttitudeError(t_us=1, estimator="{estimator}", roll=0.0, pitch=0.0, yaw=0.0, angle=0.0),
        fused,
        msgspec.structs.replace(fused, name="another"),
    ]
    published: list[str] = []

    class Bus:
        """One that only notes the keys: placeholders are no keys that Zenoh would take."""

        def put(self, suffix: str, *_: object, history: int = 0) -> None:
            published.append(suffix)

    Publisher(Bus()).publish(results)  # type: ignore[arg-type]
    schema = json.loads((Path(__file__).parents[3] / "docs" / "zenoh.schema.json").read_text())
    listed = {key for key in schema["keys"] if not key.startswith(("proxy/", "schedule/"))}
    assert set(published) == listed


def test_a_plain_get_finds_nothing_and_a_late_joiner_gets_the_newest() -> None:
    with open_bus("tcp/127.0.0.1:0", run="t", router=True) as bus:
        Publisher(bus).publish([decision(0.0), decision(0.4, ("G12",))])
        with open_bus(bus.url, run="t") as late:
            replies = [reply.ok for reply in late._session.get(late.key("fdi/isolation"))]
            got: queue.Queue[bytes] = queue.Queue(20)
            late.subscribe("fdi/isolation", lambda _, data: got.put(data))
            kept = decode(got.get(timeout=60))
    assert replies == []
    assert kept == decision(0.4, ("G12",))

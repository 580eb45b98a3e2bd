"""Labels and watched messages of a proxy, stored for callers that wait for a condition."""

import threading
import time
from collections.abc import Callable, Sequence

from mavproxy_fault.live.subscriptions import LEASE_S, Watched
from mavproxy_fault.schedule.triggers import Condition, Telemetry
from mavproxy_fault.wire.dialect import find_layout, message_layout
from mavproxy_fault.wire.frame import Frame, build_frame
from mavproxy_fault.wire.label import Label, latest_labels

RENEW_S = LEASE_S / 2.0  # half the lease, so that one late renewal loses nothing


class ProxyObserver:
    """Stores what a proxy reports; its thread writes, the callers' threads read."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._waiting: list[Telemetry] = []
        self._labels: list[Label] = []

    @property
    def labels(self) -> list[Label]:
        """The newest label of every activation of a fault."""
        with self._changed:
            return latest_labels(self._labels)

    def add_labels(self, labels: Sequence[Label]) -> None:
        """Add labels that began or ended."""
        with self._changed:
            self._labels += labels

    def add_samples(self, samples: Sequence[Watched]) -> None:
        """Add the samples of watched messages, as they left the proxy."""
        with self._changed:
            for frame in (frame for watched in samples for frame in frames_of(watched)):
                for telemetry in self._waiting:
                    telemetry.note(frame)
            # Once for all samples, since a waiting thread tests the newest state only.
            self._changed.notify_all()

    def wait_for(
        self, condition: Condition, timeout_s: float, watch: Callable[[list[str]], object]
    ) -> None:
        """Return once the condition holds for what has left the proxy since this call.

        Raises
        ------
        TimeoutError
            If it does not within `timeout_s`.
        """
        names = [message_layout(number).name for number in sorted(condition.ids)]
        deadline_s = time.monotonic() + timeout_s
        telemetry = Telemetry()  # a new one, since older values may be outdated
        with self._changed:
            self._waiting.append(telemetry)
        try:
            while True:
                watch(names)  # without the lock, since the proxy's thread replies
                with self._changed:
                    # Before the lease ends: the proxy then drops the subscription.
                    renew_s = min(time.monotonic() + RENEW_S, deadline_s)
                    while not condition.holds(telemetry) and time.monotonic() < renew_s:
                        self._changed.wait(renew_s - time.monotonic())
                    if condition.holds(telemetry):
                        return
                if time.monotonic() >= deadline_s:
                    raise TimeoutError(f"{condition.text!r} did not hold within {timeout_s:g} s")
        finally:
            with self._changed:
                self._waiting.remove(telemetry)


def frames_of(watched: Watched) -> list[Frame]:
    """Rebuild the sent frames, so that a wait and a schedule's `when` use the same conditions."""
    described = find_layout(watched.message)
    if described is None:
        return []  # pseudoranges travel in TUNNEL; no condition reads them
    frames = []
    # The sent values if a fault changed them, else the received ones.
    for _, *row in watched.received if watched.sent is None else watched.sent:
        values: dict[str, object] = {}
        arrays: dict[str, list[object]] = {}
        for name, value in zip(watched.fields, row, strict=True):
            base, _, index = name.partition("[")
            if index:
                # The items of an array arrive as separate fields.
                values[base] = arrays.setdefault(base, [])
                arrays[base].append(value)
            else:
                values[base] = value
        raw = build_frame(described, values, system=watched.system, component=watched.component)
        frames.append(Frame(raw, described))
    return frames

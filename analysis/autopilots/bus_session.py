"""Publish an autopilot's flight on Zenoh, and accept fault control from the page."""

import time
from collections.abc import Sequence
from typing import Any

from analysis.monitor.publish import Publisher
from analysis.run.proxied_flight import ProxiedFlight
from mavproxy_fault.links.bus import Bus
from mavproxy_fault.live.edit_log import EditLog
from mavproxy_fault.live.session import LiveSession
from mavproxy_fault.wire.label import Label


class AutopilotBusSession:
    """One flight on the bus; the edit log records every request, so that a replay repeats it."""

    def __init__(self, bus: Bus, flight: ProxiedFlight, edit_log: EditLog) -> None:
        self._flight = flight
        self._live = LiveSession(flight.control, lambda: edit_log.begin(flight.now_us), edit_log)
        self._publisher = Publisher(bus)
        self._live.offer(bus)

    def serve(self) -> None:
        """Carry out requests and publish changes; called at every step."""
        self._live.serve()
        # The wall clock only paces the page, not the flight.
        self._live.show(time.monotonic())

    def publish_results(self, results: Sequence[Any]) -> None:
        """Publish the monitor's results."""
        self._publisher.publish(list(results))

    def publish_labels(self, labels: Sequence[Label]) -> None:
        """Publish the state of links and faults."""
        self._live.publish(self._flight.stats(), labels)

    def close(self) -> None:
        """Refuse further requests."""
        self._live.close()

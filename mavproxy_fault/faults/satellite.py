"""Satellite faults: errors on the pseudoranges of some satellites, or satellites lost.

Raw ranges travel as RTCM 3 in TUNNEL fragments, so a fault buffers fragments until a message is
complete, patches the message and sends its fragments. Messages other than MSM7 and stray fragments
are forwarded unchanged.
"""

import math
from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

import msgspec

from mavproxy_fault.fault_parts.fault import ActsOn, Generator, Outgoing
from mavproxy_fault.fault_parts.profile import hold_live_value
from mavproxy_fault.fault_parts.value_fault import (
    MOST_SENDERS,
    ValueFault,
    broadcast_values,
    can_add_sender,
)
from mavproxy_fault.faults.loss import Drop
from mavproxy_fault.rinex.range_epoch import RangeEpoch
from mavproxy_fault.rtcm import transport as rtcm
from mavproxy_fault.rtcm.msm7 import SYSTEMS, msm7_satellites, patch_msm7
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame, build_frame

HOLD_US = 500_000  # fragments of one message leave a receiver within milliseconds

Sender = tuple[int, int, int]  # system, component, sequence number of the RTCM message


class PartialMessage(NamedTuple):
    """Fragments of an incomplete message in order of arrival."""

    since_us: int
    frames: tuple[Frame, ...]
    parts: Mapping[int, bytes]


class SatelliteFaultState(NamedTuple):
    """The state: start of the fault, state of the inner fault, and buffered fragments."""

    start_us: int
    inner: Any
    partial: Mapping[Sender, PartialMessage]


class SatelliteFault(msgspec.Struct, frozen=True, kw_only=True):
    """A value fault or `Drop` applied to pseudoranges instead of fields."""

    acts_on: ClassVar[ActsOn] = "satellites"
    keeps_back: ClassVar[bool] = True  # a frame without a magnitude is unchanged

    fault: ValueFault | Drop
    names: tuple[str, ...]

    def __post_init__(self) -> None:
        check_count(self.fault, self.names)

    def new_state(self, start_us: int) -> SatelliteFaultState:
        """Return the state without buffered fragments."""
        return SatelliteFaultState(start_us, None, {})

    def apply(
        self, frame: Frame, t_us: int, state: SatelliteFaultState, rng: Generator
    ) -> tuple[list[Outgoing], SatelliteFaultState]:
        """Buffer a fragment or patch the message that it completes; or change a file's epoch."""
        if isinstance(frame, RangeEpoch):
            return self._in_epoch(frame, t_us, state, rng)
        payload = rtcm.tunnel_payload(frame)
        if payload is None:
            return [Outgoing(t_us, frame)], state
        # Not fragmented: a complete message.
        if not payload[0] & 1:
            return self._patch_message((frame,), payload[1:], payload[0] >> 3, t_us, state, rng)
        key = (frame.system, frame.component, payload[0] >> 3)
        # Flags byte: bit 0 fragmented, bits 1 and 2 the fragment, 3 to 7 the message.
        number = payload[0] >> 1 & 3
        old = state.partial.get(key)
        broken: list[Outgoing] = []
        # A repeated fragment number belongs to the next message: a fragment was lost.
        if old is not None and (number in old.parts or t_us - old.since_us > HOLD_US):
            broken, old = _forward_all(old, t_us), None
        since_us, frames, parts = old or PartialMessage(t_us, (), {})
        new = PartialMessage(since_us, (*frames, frame), {**parts, number: payload[1:]})
        complete = rtcm.join_fragments(dict(new.parts))
        # The entry of this sender is replaced below.
        others = {sender: part for sender, part in state.partial.items() if sender != key}
        if len(others) >= MOST_SENDERS:  # bounded: a peer can make up any number of senders
            broken += _forward_all(others.pop(next(iter(others))), t_us)
        if complete is None:
            return broken, state._replace(partial={**others, key: new})
        sends, state = self._patch_message(new.frames, complete, key[2], t_us, state, rng)
        return broken + sends, state._replace(partial=others)

    def _patch_message(
        self,
        frames: tuple[Frame, ...],
        data: bytes,
        sequence: int,
        t_us: int,
        state: SatelliteFaultState,
        rng: Any,
    ) -> tuple[list[Outgoing], SatelliteFaultState]:
        """Return the fragments of a complete message with the fault applied."""
        healthy = [Outgoing(t_us, frame) for frame in frames]
        present = self._target_satellites(data)
        if not present:
            return healthy, state
        changes_m, lost, inner = self._errors(frames[0], present, t_us, state, rng)
        state = state._replace(inner=inner)
        message = patch_msm7(data, changes_m, lost)
        # Nothing changed: the fragments are sent byte for byte as received.
        if message == data:
            return healthy, state
        # A lost satellite has no magnitude; NaN still marks the frame as changed.
        size_m = max((abs(change) for change in changes_m.values()), default=math.nan)
        sends = [
            Outgoing(t_us, replace_tunnel_payload(frame, payload), size_m)
            # With lost satellites the message may need fewer fragments.
            for frame, payload in zip(frames, rtcm.split_fragments(message, sequence), strict=False)
        ]
        return sends, state

    def _in_epoch(
        self, epoch: Any, t_us: int, state: SatelliteFaultState, rng: Generator
    ) -> tuple[list[Outgoing], SatelliteFaultState]:
        """Apply the fault to a `RangeEpoch`, a frame to the engine."""
        present = [n for n in self.names if n in epoch.satellites and n not in epoch.lost]
        if not present:
            return [Outgoing(t_us, epoch)], state
        changes_m, lost, inner = self._errors(epoch, present, t_us, state, rng)
        state = state._replace(inner=inner)
        if not lost and not any(changes_m.values()):
            return [Outgoing(t_us, epoch)], state
        size_m = max((abs(change) for change in changes_m.values()), default=math.nan)
        return [Outgoing(t_us, epoch.changed(changes_m, lost), size_m)], state

    def _target_satellites(self, data: bytes) -> list[str]:
        """Return the target's satellites that an MSM7 message contains."""
        if rtcm.message_number(data) not in SYSTEMS:
            return []
        try:
            satellites = msm7_satellites(data)
        except ValueError:
            return []  # corrupted: forwarded as it is
        return [name for name in self.names if name in satellites]

    def _errors(
        self, frame: Frame, present: list[str], t_us: int, state: SatelliteFaultState, rng: Any
    ) -> tuple[dict[str, float], list[str], Any]:
        if isinstance(self.fault, Drop):
            lost = [name for name in present if rng.random() < self.fault.value]
            return {}, lost, None
        t_s = (t_us - state.start_us) / 1e6
        key = (frame.system, frame.component)
        # For all satellites of the target, also those out of view: the error of one must not
        # depend on which others are in view.
        healthy: list[int | float] = [0.0] * len(self.names)
        if not can_add_sender(state.inner, key):
            return {}, [], state.inner
        errors, inner = self.fault.after(healthy, key, t_s, state.inner, rng)
        by_name = dict(zip(self.names, errors, strict=True))
        return {name: float(by_name[name]) for name in present}, [], inner

    def fed(self, state: SatelliteFaultState, value: float, t_us: int) -> SatelliteFaultState:
        """The state after a live value that came at `t_us`."""
        memory = None if state.inner is None else state.inner[()]
        held = hold_live_value(memory, state.start_us, t_us, value)
        return state._replace(inner={(): held})

    def release_us(self, state: SatelliteFaultState) -> int | None:
        """Return when the oldest incomplete message must be sent."""
        return min((message.since_us + HOLD_US for message in state.partial.values()), default=None)

    def release(
        self, t_us: int, state: SatelliteFaultState
    ) -> tuple[list[Outgoing], SatelliteFaultState]:
        """Return all buffered fragments, unchanged."""
        sends = [out for message in state.partial.values() for out in _forward_all(message, t_us)]
        return sends, state._replace(partial={})


def _forward_all(message: PartialMessage, t_us: int) -> list[Outgoing]:
    return [Outgoing(t_us, frame) for frame in message.frames]


def check_count(fault: object, names: tuple[str, ...]) -> None:
    """Refuse a list without exactly one number for each satellite.

    Raises
    ------
    ValueError
        If the list is longer or shorter.
    """
    value = getattr(fault, "value", None)
    if isinstance(value, tuple):
        broadcast_values(value, len(names))


def replace_tunnel_payload(frame: Frame, payload: bytes) -> Frame:
    """Replace the payload of a TUNNEL frame; header and signature block stay."""
    layout = message_layout("TUNNEL")
    values = {
        "payload_type": rtcm.PAYLOAD_TYPE,
        "target_system": frame.number("target_system"),
        "target_component": frame.number("target_component"),
        "payload_length": len(payload),
        "payload": payload,
    }
    return frame.with_payload(Frame(build_frame(layout, values), layout).payload)

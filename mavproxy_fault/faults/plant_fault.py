"""Faults that act in the simulator: of the plant, and of satellites in its receiver.

The proxy forwards the simulator's frames and replies with the current value of a parameter whenever
it has changed or 0.2 s have passed. When the fault ends, a last message restores the healthy value.
"""

from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import msgspec

from mavproxy_fault.fault_parts.fault import ActsOn, Generator, Outgoing
from mavproxy_fault.fault_parts.profile import Profile, hold_live_value
from mavproxy_fault.fault_parts.value_fault import ValueFault
from mavproxy_fault.faults.loss import Drop
from mavproxy_fault.faults.satellite import check_count
from mavproxy_fault.rinex.range_epoch import RangeEpoch, Setting
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame
from mavproxy_fault.wire.plant_messages import SIMULATOR, PlantChange, plant_frame
from mavproxy_fault.wire.plant_names import SATELLITES

REPEAT_US = 200_000  # chosen: a lost datagram is repaired within 0.2 s
STEP_US = 20_000  # a changing value is sent at 50 Hz at most: bounds the traffic

Values = tuple[float | None, ...]


class PlantFaultState(NamedTuple):
    """The start of the fault, the receiver, values and time of its last message, profile state."""

    start_us: int
    target: tuple[int, int] = SIMULATOR
    values: Values | None = None
    at_us: int = 0
    inner: Any = None


class SimulatorFault(msgspec.Struct, frozen=True, kw_only=True):
    """Base of faults that send the values of `names` to the simulator."""

    names: tuple[str, ...] = ()

    def new_state(self, start_us: int) -> PlantFaultState:
        """Return the state before the first message."""
        return PlantFaultState(start_us)

    def values(self, t_s: float, state: Any, rng: Generator) -> tuple[Values, Any]:
        """Return the value of each name, `t_s` after the start of the fault."""
        raise NotImplementedError

    def apply(
        self, frame: Frame, t_us: int, state: PlantFaultState, rng: Generator
    ) -> tuple[list[Outgoing], PlantFaultState]:
        """Forward the frame; reply to one of a simulator with the values."""
        forwarded = Outgoing(t_us, frame)
        since_us = t_us - state.at_us
        # Only a simulator accepts them, and not every frame needs a reply.
        if frame.component != SIMULATOR[1] or (state.values is not None and since_us < STEP_US):
            return [forwarded], state
        values, inner = self.values((t_us - state.start_us) / 1e6, state.inner, rng)
        # Repeated, since a datagram may be lost.
        if values == state.values and since_us < REPEAT_US:
            return [forwarded], state._replace(inner=inner)
        target = (frame.system, frame.component)
        messages = self._messages(values, target, t_us)
        return [forwarded, *messages], PlantFaultState(state.start_us, target, values, t_us, inner)

    def idle_until_us(self, state: PlantFaultState) -> int:
        """Return the time before which `apply` changes nothing."""
        constant = getattr(self, "value", None) is not None
        return state.at_us + (REPEAT_US if constant else STEP_US)

    def fed(self, state: PlantFaultState, value: float, t_us: int) -> PlantFaultState:
        """Return the state after a live value that arrived at `t_us`."""
        return state._replace(inner=hold_live_value(state.inner, state.start_us, t_us, value))

    def release(self, t_us: int, state: PlantFaultState) -> tuple[list[Outgoing], PlantFaultState]:
        """Restore the healthy values at the end."""
        # Nothing was sent to the simulator.
        if state.values is None:
            return [], state
        # None means healthy to the simulator.
        healthy = (None,) * len(self.names)
        return self._messages(healthy, state.target, t_us), state._replace(values=healthy)

    def _messages(
        self, values: Sequence[float | None], target: tuple[int, int], t_us: int
    ) -> list[Outgoing]:
        layout = message_layout("TUNNEL")
        return [
            Outgoing(
                t_us,
                Frame(plant_frame(PlantChange(name, value), target), layout),
                # The magnitude of the label; a healthy value has none.
                None if value is None else abs(value),
                back=True,
            )
            for name, value in zip(self.names, values, strict=True)
        ]


class PlantFault(SimulatorFault, frozen=True, kw_only=True):
    """Set a parameter of the simulated plant to `value`, or to a profile of absolute values."""

    name: ClassVar[str] = "plant"
    example: ClassVar[dict[str, Any]] = {"target": "PLANT.mass_kg_add", "value": 0.5}
    acts_on: ClassVar[ActsOn] = "plant"

    value: float | None = None
    profile: Profile | None = None

    def __post_init__(self) -> None:
        if (self.value is None) == (self.profile is None):
            raise ValueError("takes either value or profile")

    def values(self, t_s: float, state: Any, rng: Generator) -> tuple[Values, Any]:
        """Return the same value for all names."""
        if self.profile is None:
            return (self.value,) * len(self.names), None
        if state is None:
            state = self.profile.new_state(rng)
        return (self.profile.value(t_s, state),) * len(self.names), state

    def apply(
        self, frame: Frame, t_us: int, state: PlantFaultState, rng: Generator
    ) -> tuple[list[Outgoing], PlantFaultState]:
        """Reply to a simulator's frame, or set the parameters in an epoch of a recording."""
        epoch: Any = frame
        if not isinstance(epoch, RangeEpoch):
            return super().apply(frame, t_us, state, rng)
        t_s = (t_us - state.start_us) / 1e6
        values, inner = self.values(t_s, state.inner, rng)
        next_values, inner = self.values(t_s + STEP_US / 1e6, inner, rng)
        state = state._replace(inner=inner)
        # None is healthy, now or after the step.
        settings = {
            name: Setting(value, 0.0 if later is None else (later - value) * 1e6 / STEP_US)
            for name, value, later in zip(self.names, values, next_values, strict=True)
            if value is not None
        }
        if not settings:
            return [Outgoing(t_us, frame)], state
        size = max(abs(setting.value) for setting in settings.values())
        changed: Any = epoch.with_settings(settings)
        return [Outgoing(t_us, changed, size)], state


class ReceiverFault(SimulatorFault, frozen=True, kw_only=True):
    """Satellite faults applied in the simulated receiver, so that its position follows.

    Range errors are sent as `pseudorange_m[G12]`, lost satellites as `satellite_lost[G12]`.
    """

    acts_on: ClassVar[ActsOn] = "satellites"

    fault: ValueFault | Drop

    def __post_init__(self) -> None:
        check_count(self.fault, self.names)
        # The simulated receiver either tracks a satellite or does not.
        if isinstance(self.fault, Drop) and self.fault.value != 1.0:
            raise ValueError(
                f"value = {self.fault.value} cannot act in the receiver, which loses a satellite"
                " entirely; omit value, or give `via: proxy`"
            )

    def values(self, t_s: float, state: Any, rng: Generator) -> tuple[Values, Any]:
        """Return metres per satellite, or 1 for lost."""
        if isinstance(self.fault, Drop):
            return (1.0,) * len(self.names), None
        # Applied to zeros, which yields the errors themselves.
        errors, state = self.fault.after([0.0] * len(self.names), (), t_s, state, rng)
        return tuple(float(error) for error in errors), state


def receiver_names(satellites: Sequence[str], fault: object) -> tuple[str, ...]:
    """Return the simulator's parameter names for satellites; a single name for all of them."""
    kind = "satellite_lost" if isinstance(fault, Drop) else "pseudorange_m"
    if set(satellites) == set(SATELLITES):
        return (f"{kind}[all]",)
    return tuple(f"{kind}[{satellite}]" for satellite in satellites)

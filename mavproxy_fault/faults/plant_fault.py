"""Faults that act in the simulator: of the plant, and of satellites in its receiver.

Such a fault rides on whatever the simulator sends: each such frame passes, and goes along with a
message back that says what a parameter is now, when that has changed or a fifth of a second has
passed. When the fault ends, the simulator is told that the parameter is healthy again.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import msgspec

from mavproxy_fault.fault_parts.fault import ActsOn, Outgoing
from mavproxy_fault.fault_parts.profile import Profile
from mavproxy_fault.fault_parts.value_fault import ValueFault
from mavproxy_fault.faults.loss import Drop
from mavproxy_fault.faults.satellite import check_count
from mavproxy_fault.rinex.range_epoch import RangeEpoch, Setting
from mavproxy_fault.wire.dialect import message_layout
from mavproxy_fault.wire.frame import Frame
from mavproxy_fault.wire.plant_messages import SIMULATOR, PlantChange, plant_frame
from mavproxy_fault.wire.plant_names import SATELLITES

if TYPE_CHECKING:
    from numpy.random import Generator

REPEAT_US = 200_000
STEP_US = 20_000  # a changing value is sent at 50 Hz at most

Values = tuple[float | None, ...]


class PlantFaultState(NamedTuple):
    """When the fault began, to whom it said what last and when, and the profile's own state."""

    start_us: int
    target: tuple[int, int] = SIMULATOR
    values: Values | None = None
    at_us: int = 0
    inner: Any = None


class SimulatorFault(msgspec.Struct, frozen=True, kw_only=True):
    """What both kinds share: telling the simulator the values of `names`."""

    names: tuple[str, ...] = ()

    def new_state(self, start_us: int) -> PlantFaultState:
        """Nothing said yet."""
        return PlantFaultState(start_us)

    def values(self, t_s: float, state: Any, rng: "Generator") -> tuple[Values, Any]:
        """The value of each name, `t_s` after the fault began."""
        raise NotImplementedError

    def apply(
        self, frame: Frame, t_us: int, state: PlantFaultState, rng: "Generator"
    ) -> tuple[list[Outgoing], PlantFaultState]:
        """Pass the frame; answer a simulator's with the values."""
        passed = Outgoing(t_us, frame)
        since_us = t_us - state.at_us
        # Only a simulator obeys, and a changing value need not be sent with every frame.
        if frame.component != SIMULATOR[1] or (state.values is not None and since_us < STEP_US):
            return [passed], state
        values, inner = self.values((t_us - state.start_us) / 1e6, state.inner, rng)
        # Repeated now and then, as a datagram may be lost.
        if values == state.values and since_us < REPEAT_US:
            return [passed], state._replace(inner=inner)
        target = (frame.system, frame.component)
        messages = self._messages(values, target, t_us)
        return [passed, *messages], PlantFaultState(state.start_us, target, values, t_us, inner)

    def fed(self, state: PlantFaultState, value: float, t_us: int) -> PlantFaultState:
        """The state after a live value that came at `t_us`."""
        return state._replace(inner=((t_us - state.start_us) / 1e6, value))

    def release_us(self, state: PlantFaultState) -> None:
        """It keeps nothing back."""

    def release(self, t_us: int, state: PlantFaultState) -> tuple[list[Outgoing], PlantFaultState]:
        """At the end: healthy again."""
        # Nothing was ever said to the simulator: there is nothing to take back.
        if state.values is None:
            return [], state
        # None is the simulator's word for healthy.
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
                # The magnitude of the label; what is healthy again has none.
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

    def values(self, t_s: float, state: Any, rng: "Generator") -> tuple[Values, Any]:
        """The same value for all."""
        if self.profile is None:
            return (self.value,) * len(self.names), None
        if state is None:
            state = self.profile.new_state(rng)
        return (self.profile.value(t_s, state),) * len(self.names), state

    def apply(
        self, frame: Frame, t_us: int, state: PlantFaultState, rng: "Generator"
    ) -> tuple[list[Outgoing], PlantFaultState]:
        """As for every such fault; an epoch of a recording has no simulator, and is set itself."""
        epoch: Any = frame
        if not isinstance(epoch, RangeEpoch):
            return super().apply(frame, t_us, state, rng)
        t_s = (t_us - state.start_us) / 1e6
        values, inner = self.values(t_s, state.inner, rng)
        later, inner = self.values(t_s + STEP_US / 1e6, inner, rng)
        state = state._replace(inner=inner)
        # None: healthy now, or for a rate soon.
        settings = {
            name: Setting(value, 0.0 if soon is None else (soon - value) * 1e6 / STEP_US)
            for name, value, soon in zip(self.names, values, later, strict=True)
            if value is not None
        }
        if not settings:
            return [Outgoing(t_us, frame)], state
        size = max(abs(setting.value) for setting in settings.values())
        changed: Any = epoch.with_settings(settings)
        return [Outgoing(t_us, changed, size)], state


class ReceiverFault(SimulatorFault, frozen=True, kw_only=True):
    """Satellite faults that the simulated receiver carries out, so that its position follows.

    Metres go to `pseudorange_m[G12]`; a lost satellite to `satellite_lost[G12]`.
    """

    acts_on: ClassVar[ActsOn] = "satellites"

    fault: ValueFault | Drop

    def __post_init__(self) -> None:
        check_count(self.fault, self.names)
        # A receiver in the simulator tracks a satellite or does not.
        if isinstance(self.fault, Drop) and self.fault.value < 1.0:
            raise ValueError(
                f"value = {self.fault.value} cannot be had in the receiver, which loses a satellite"
                " wholly; leave value out, or give `via: proxy`"
            )

    def values(self, t_s: float, state: Any, rng: "Generator") -> tuple[Values, Any]:
        """Metres per satellite, or 1 for lost."""
        if isinstance(self.fault, Drop):
            return (1.0,) * len(self.names), None
        # On zeros: the values that come out are the errors themselves.
        errors, state = self.fault.after([0.0] * len(self.names), (), t_s, state, rng)
        return tuple(float(error) for error in errors), state


def receiver_names(satellites: Sequence[str], fault: object) -> tuple[str, ...]:
    """The simulator's names for a fault on some satellites; one name for all that there are."""
    kind = "satellite_lost" if isinstance(fault, Drop) else "pseudorange_m"
    # One name instead of a list of all.
    if set(satellites) == set(SATELLITES):
        return (f"{kind}[all]",)
    return tuple(f"{kind}[{satellite}]" for satellite in satellites)

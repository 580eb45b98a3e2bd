"""The open-loop controller of a fixed wing: constant controls, optionally weaving."""

import math
from typing import TYPE_CHECKING

import numpy as np

from mavproxy_fault.numerics.arrays import Array
from simvehicle.guidance.fixedwing_controller import FixedWingController
from simvehicle.vehicles.body import Controls, Truth
from simvehicle.vehicles.fixedwing.fixedwing import FixedWing
from simvehicle.vehicles.fixedwing.weave_kernel import weave_controls

if TYPE_CHECKING:
    from simvehicle.scenario.scenario_file import OpenLoopControls


class OpenLoopController(FixedWingController):
    """Keeps the controls constant, or weaves; with a track it becomes a path controller.

    `plan` is that of `weave_controls`, empty without weaving.
    """

    rate_hz = math.inf  # updates at every step

    def __init__(
        self, vehicle: FixedWing, density: float, home_alt_m: float, plan: "OpenLoopControls"
    ) -> None:
        super().__init__(vehicle, density, home_alt_m)
        surfaces = np.radians([plan.elevator_deg, plan.aileron_deg, plan.rudder_deg])
        controls, throws = np.array([*surfaces, plan.throttle]), [*vehicle.throw_rad, 1.0]
        self._constant = controls / throws
        self.plan: Array = np.empty(0)
        if plan.weave is not None:
            roll, pitch = np.radians([plan.weave.roll_deg, plan.weave.pitch_deg])
            airspeed_mps = plan.weave.airspeed_mps
            assert airspeed_mps is not None  # as `Scenario` checks
            aim = [roll, plan.weave.period_s, pitch, airspeed_mps]
            self.plan = np.array([*aim, *controls, *throws])

    def update(self, truth: Truth) -> Controls:
        """Controls for the next step."""
        if self.track is not None:
            self.rate_hz = FixedWingController.rate_hz
            return super().update(truth)
        controls = self._constant.copy()
        if len(self.plan):
            weave_controls(
                truth.t_us * 1e-6, truth.q_nb, truth.omega_b_rps, truth.v_air_b_mps, self.plan,
                controls,
            )  # fmt: skip
        return Controls(controls)

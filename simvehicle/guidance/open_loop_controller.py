"""The open-loop controller of a fixed wing: constant controls, optionally weaving."""

import math
from typing import TYPE_CHECKING

import numpy as np

from mavproxy_fault.numerics.rotations.one_rotation import euler_angles
from simvehicle.guidance.fixedwing_controller import FixedWingController
from simvehicle.vehicles.body import Controls, Truth
from simvehicle.vehicles.fixedwing.fixedwing import FixedWing
from simvehicle.vehicles.fixedwing.weave_kernel import Four, WeaveFeedback, weave_controls

if TYPE_CHECKING:
    from simvehicle.scenario.scenario_file import OpenLoopControls


class OpenLoopController(FixedWingController):
    """Keeps the controls constant, or weaves; with a track it becomes a path controller."""

    rate_hz = math.inf  # updates at every step

    def __init__(
        self, vehicle: FixedWing, density: float, home_alt_m: float, plan: "OpenLoopControls"
    ) -> None:
        super().__init__(vehicle, density, home_alt_m)
        elevator, aileron, rudder = np.radians(
            [plan.elevator_deg, plan.aileron_deg, plan.rudder_deg]
        )
        self._controls = (float(elevator), float(aileron), float(rudder), plan.throttle)
        self._aim: Four | None = None
        if plan.weave is not None:
            roll, pitch = np.radians([plan.weave.roll_deg, plan.weave.pitch_deg])
            airspeed_mps = plan.weave.airspeed_mps
            assert airspeed_mps is not None  # as `Scenario` checks
            self._aim = (float(roll), plan.weave.period_s, float(pitch), airspeed_mps)

    def update(self, truth: Truth) -> Controls:
        """Controls for the next step."""
        if self.track is not None:
            self.rate_hz = FixedWingController.rate_hz
            return super().update(truth)
        controls = self._controls
        if self._aim is not None:
            roll, pitch, _ = euler_angles(truth.q_nb.tolist())
            p, q, _ = truth.omega_b_rps.tolist()
            airspeed = math.hypot(*truth.v_air_b_mps.tolist())
            motion = WeaveFeedback(float(roll), float(pitch), p, q, airspeed)
            controls = weave_controls(motion, self._aim, self._controls, truth.t_us * 1e-6)
        throws = (*self.vehicle.throw_rad, 1.0)
        return Controls(np.array(controls) / throws)

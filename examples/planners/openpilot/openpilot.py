"""openpilot's longitudinal MPC: it follows the car ahead and keeps the set speed. Steering is ours: pure pursuit of the route.

    sh examples/planners/openpilot/build.sh ~/openpilot    # once; a checkout of openpilot, such as commit 007bc41c
    sage search scenes/ --ego 'openpilot=cmd:python3 examples/planners/openpilot/openpilot.py /home/me/openpilot' --out failures/

The author's `long_mpc.py` (MIT; acados is BSD-2-Clause, casadi LGPL-3.0) runs as it stands. Ours are, after its `longitudinal_planner.py`: limits of acceleration, also in turns, and the
smoothed speed; and, in place of the car's radar and driver: one lead, the next road user ahead on the route, its acceleration as a smoothed
difference of speeds, and a set speed from the limits of the route's lanes. It minds neither lights nor crossing traffic: a driver does.
"""

import math
import os
import statistics
import sys
from types import SimpleNamespace

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), ".."))
from sage_planner import serve  # first: it keeps the standard output for answers

from mpc import acados_template, load

STEP = 0.1
#: Set speed where no lane of the route has a limit, m/s.
SET_SPEED = 13.9
LEAST_ACCELERATION = -1.2
#: Largest acceleration by speed, and largest acceleration of both axes in turns.
MOST_ACCELERATION = ([0.0, 15.0, 25.0, 40.0], [1.2, 1.2, 0.8, 0.6])
MOST_IN_TURNS = ([20.0, 40.0], [1.7, 3.2])
#: Time constant of the smoothed speed, s.
SMOOTHING = 2.0
#: A leader of another gap (m) or speed (m/s) in one step is another car.
OTHER_GAP, OTHER_SPEED = 3.0, 1.5
#: Share of a new difference in a leader's acceleration; decay of that acceleration as the radar has it.
NEW, TAU, KEPT_TAU, BRISK = 0.3, 1.5, 0.9, 0.5
NOBODY = SimpleNamespace(status=False, modelProb=0.0)


class Lead:
    """What the radar would say of the car ahead."""

    def __init__(self):
        self.gap = None

    def seen(self, leader):
        if leader is None:
            self.gap = None
            return NOBODY
        gap, speed = leader
        if self.gap is None or abs(gap - self.gap) > OTHER_GAP or abs(speed - self.speed) > OTHER_SPEED:
            self.acceleration, self.tau = 0.0, TAU
        else:
            self.acceleration += NEW * ((speed - self.speed) / STEP - self.acceleration)
            self.tau = TAU if abs(self.acceleration) < BRISK else self.tau * KEPT_TAU
        self.gap, self.speed = gap, speed
        return SimpleNamespace(
            status=True, dRel=gap, vLead=max(speed, 0.0), aLeadK=self.acceleration, aLeadTau=self.tau, modelProb=1.0
        )


def between(value, points, values):
    """Linear interpolation."""
    for k in range(1, len(points)):
        if value <= points[k]:
            share = max(value - points[k - 1], 0.0) / (points[k] - points[k - 1])
            return values[k - 1] + share * (values[k] - values[k - 1])
    return values[-1]


class Openpilot:
    def __init__(self, module):
        self.module, self.mpc = module, module.LongitudinalMpc()

    def reset(self, scene, seed):
        self.scene, self.lead, self.speed, self.acceleration = scene, Lead(), None, 0.0
        # All of the solver's state goes: the drive before must not be felt.
        self.mpc = self.module.LongitudinalMpc()
        limits = {f["id"]: f.get("speed_limit") for f in scene.map}
        limits = [limits[k] for k in scene.route_lanes if limits.get(k)]
        self.set_speed = statistics.median(limits) if limits else SET_SPEED

    def act(self, obs):
        ego, car = obs.ego, self.scene.car
        speed = max(ego.speed, 0.0)
        keeps = math.exp(-STEP / SMOOTHING)
        self.speed = speed if self.speed is None else keeps * self.speed + (1.0 - keeps) * speed
        sideways = speed**2 * math.tan(ego.steering_angle) / (car.front_axle + car.rear_axle)
        in_turns = math.sqrt(max(between(speed, *MOST_IN_TURNS) ** 2 - sideways**2, 0.0))
        most = min(between(speed, *MOST_ACCELERATION), in_turns)
        # Limits move as slowly as the author lets them, 0.05 m/s2 a step.
        self.mpc.set_accel_limits(min(LEAST_ACCELERATION, self.acceleration + 0.05), max(most, self.acceleration - 0.05))
        self.mpc.set_cur_state(self.speed, self.acceleration)
        lead = self.lead.seen(obs.leader(self.scene.route))
        self.mpc.update(None, SimpleNamespace(leadOne=lead, leadTwo=NOBODY), self.set_speed)
        before, times = self.acceleration, list(self.module.T_IDXS)
        self.acceleration = between(STEP, times, list(self.mpc.a_solution))
        self.mpc.prev_a = [between(t + STEP, times, list(self.mpc.a_solution)) for t in times]
        self.speed += STEP * (self.acceleration + before) / 2.0
        seen = f"lead {lead.dRel:.1f} m at {lead.vLead:.1f} m/s {lead.aLeadK:+.1f} m/s2" if lead.status else "no lead"
        print(f"t {obs.t:.1f} speed {speed:.1f} of {self.set_speed:.1f}, {seen}, by {self.mpc.source}: {self.acceleration:+.2f} m/s2", file=sys.stderr)
        steer = obs.steer_to(self.scene.route, 2.0 + 0.3 * speed)
        return {"acceleration": self.acceleration, "steering_angle": steer * car.max_steering_angle}


if __name__ == "__main__":
    checkout = sys.argv[1] if len(sys.argv) == 2 else sys.exit("usage: openpilot.py CHECKOUT (see build.sh)")
    serve(Openpilot(load(checkout, acados_template(checkout))))

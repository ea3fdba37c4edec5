"""FISS+, a sampling planner for urban roads (pip install fiss-planner), with its author's defaults.

    sage search scenes/ --ego 'fiss=cmd:python3 examples/planners/fiss/fiss.py' --out failures/

Lanes, widths, neighbours and line types, the lanes of the route, and red lights go in; road users are predicted by the author's own
models. It offers three ways to follow its plan: `plan` (sage's tracker), `exact` (the poses of the plan) and `mpc` (the author's controller).
`--set NAME=VALUE` changes an option of the planner, such as `stitching.enabled=False` or `planner.type=fop_plus`.
"""

import ast
import math
import os
import sys

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), ".."))
from sage_planner import serve  # first: it keeps the standard output for answers

import fiss_planner as fp
import numpy as np

LANES = ("LANE_SURFACE_STREET", "LANE_FREEWAY", "LANE_SURFACE_UNSTRUCTURE")
HALF_LANE, NARROWEST, WIDEST = 1.75, 1.4, 2.2
REACH, MARGIN, STEP, POSES = 120.0, 0.2, 0.1, 40


def line_type(name):
    types = {"EDGE": fp.LineType.ROAD_EDGE, "SOLID": fp.LineType.SOLID, "BROKEN": fp.LineType.DASHED}
    return next((types[word] for word in types if word in (name or "")), fp.LineType.UNKNOWN)


def longest(stretches):
    return max(stretches, key=lambda stretch: stretch["to"] - stretch["from"], default=None)


def map_lane(feature, numbers):
    """A lane of the scene as FISS+ has it."""
    lane, centre = fp.MapLane(), np.array(feature["points"], dtype=float)[:, :2]
    lane.id, way = numbers[feature["id"]], np.gradient(centre, axis=0)
    normal = np.stack([-way[:, 1], way[:, 0]], axis=1) / np.maximum(np.hypot(way[:, 0], way[:, 1]), 1e-9)[:, None]
    width = [[HALF_LANE if w is None else min(max(w, NARROWEST), WIDEST) for w in sides] for sides in feature["width"]]
    width = np.array(width)[:, :, None]
    lane.centerline, lane.left, lane.right = centre, centre + width[:, 0] * normal, centre - width[:, 1] * normal
    lane.successors = [numbers[k] for k in feature["exits"] if k in numbers]
    lane.predecessors = [numbers[k] for k in feature["entries"] if k in numbers]
    lane.speed_limit = feature["speed_limit"] or math.inf
    for side in ("left", "right"):
        bound = longest(feature["boundaries"][side])
        setattr(lane, side + "_type", line_type(bound and bound["type"]))
        beside = longest([n for n in feature["neighbors"][side] if n["lane"] in numbers])
        if beside is not None and 2 * (beside["to"] - beside["from"]) >= len(centre):
            setattr(lane, side + "_neighbor", numbers[beside["lane"]])
            setattr(lane, "can_change_" + side, line_type(beside["line"]) not in (fp.LineType.SOLID, fp.LineType.ROAD_EDGE))
    return lane


def road_map(scene):
    """The road, the numbers of its lanes by their ids, and the lights that have a stop line."""
    features = [f for f in scene.map if f["type"] in LANES and len(f["points"]) > 1]
    numbers = {feature["id"]: k + 1 for k, feature in enumerate(features)}
    road, centres = fp.RoadMap(), {}
    for feature in features:
        lane = map_lane(feature, numbers)
        road.add_lane(lane)
        centres[feature["id"]] = lane.centerline
    for k, light in enumerate(scene.all_lights):
        if light["lane"] in numbers:
            line = centres[light["lane"]]
            lengths = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
            nearest = np.argmin(np.hypot(*(line - (light["point"] or line[0])).T))
            road.add_stop_line(fp.StopLine(k, numbers[light["lane"]], float(lengths[nearest]), False))
    road.finalize()
    return road, numbers


class FissPlus:
    follows = ("exact", "plan", "mpc")

    def __init__(self, options):
        self.options, self.maps = options, {}

    def reset(self, scene, seed):
        if scene.id not in self.maps:
            self.maps = {scene.id: road_map(scene)}  # drives of a scene come one after another
        self.road, numbers = self.maps[scene.id]
        car, vehicle = scene.car, fp.VehicleParams()
        vehicle.length, vehicle.width = car.length, car.width
        vehicle.wheelbase, vehicle.rear_axle_to_center = car.front_axle + car.rear_axle, car.rear_axle
        vehicle.max_steer, vehicle.max_speed = car.max_steering_angle, min(30.0, car.max_speed)
        config = fp.LocalPlannerConfig()
        for name, value in self.options:
            *path, last = name.split(".")
            target = config
            for part in path:
                target = getattr(target, part)
            setattr(target, last, fp.planner_type_from_string(value) if name == "planner.type" else ast.literal_eval(value))
        self.horizon = config.planner.sampling.max_t + 0.5
        self.planner = fp.LocalPlanner(config, vehicle)
        self.planner.set_map(self.road, [numbers[k] for k in scene.route_lanes if k in numbers])
        self.sharpest = math.tan(vehicle.max_steer) / vehicle.wheelbase
        self.controller = fp.make_controller("mpc", vehicle)
        self.ids, self.kept, self.follow = {}, None, scene.follow or "exact"

    def obstacle(self, agent):
        number = self.ids.setdefault(agent.id, len(self.ids))  # stable in a drive, and 0 or more
        heading = math.atan2(agent.vy, agent.vx) if agent.speed > 0.5 else agent.heading
        body = (agent.x, agent.y, heading, agent.speed, agent.length + MARGIN, agent.width + MARGIN, self.horizon, STEP)
        if agent.type == "vehicle":
            return fp.predict_lane_following(self.road, number, *body)
        return fp.predict_constant_velocity(number, *body)

    def rows(self, obs, plan, since):
        """Poses of the plan in the car's frame. Where it hardly moves its headings jump, so the car turns as far as its wheels allow."""
        rows, (x, y, heading) = [], (0.0, 0.0, 0.0)
        for k in range(POSES):
            pose, before = plan.sample(since + STEP * (k + 1)), (x, y)
            x, y = obs.to_car(pose.x, pose.y)
            turn, most = math.remainder(pose.yaw - obs.ego.heading - heading, math.tau), self.sharpest * math.dist((x, y), before)
            heading += min(max(turn, -most), most)
            rows.append([x, y, heading, pose.v])
        return rows

    def act(self, obs):
        ego, speed = obs.ego, max(obs.ego.speed, 0.0)
        kappa = ego.yaw_rate / speed if speed > 1.0 else 0.0
        acceleration = min(max(ego.acceleration, -8.0), 4.0)
        state = fp.EgoState(ego.x, ego.y, ego.heading, speed, acceleration, kappa)
        for line in self.road.stop_lines:
            self.planner.set_stop_line_active(line.id, obs.all_lights[line.id] in ("red", "yellow"))
        near = [a for a in obs.agents if math.hypot(a.x - ego.x, a.y - ego.y) <= REACH]
        out = self.planner.step(obs.t, state, [self.obstacle(agent) for agent in near])
        flags = [name for name in ("emergency", "fallback", "degraded") if getattr(out, name)]
        names = {number: k for k, number in self.ids.items()}
        lead = out.stats.lead
        print(f"t {obs.t:.1f} speed {speed:.1f} target {out.target_speed:.1f} lead {names.get(lead.id)} {lead.gap:.1f} m", *flags, file=sys.stderr)
        if len(out.trajectory) >= 2:
            self.kept = (out.trajectory, obs.t)
        if self.kept is None:
            return {"acceleration": -4.0, "steering_angle": 0.0}
        plan, since = self.kept
        if self.follow == "mpc":
            command = self.controller.compute(state, plan, obs.t - since)
            return {"acceleration": command.accel, "steering_angle": command.steer}
        rows = self.rows(obs, plan, obs.t - since)
        return {"plan": rows, "follow": "exact"} if self.follow == "exact" else rows


if __name__ == "__main__":
    settings = [text.split("=", 1) for flag, text in zip(sys.argv[1:], sys.argv[2:]) if flag == "--set"]
    serve(FissPlus(settings))

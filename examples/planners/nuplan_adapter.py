"""A planner of nuPlan in the ego's seat: `compute_planner_trajectory` gets the inputs that nuPlan would give, as objects with the
same attributes, and its trajectory becomes a plan.

    from nuplan_adapter import from_nuplan
    from sage_planner import serve
    serve(from_nuplan(MyNuPlanPlanner()))

What is handed over is what planners that look at agents and their own state use:

- `PlannerInput`: `iteration.index`, `iteration.time_s`, `history.ego_states`, `history.observations` (ten frames, the oldest
  first), `history.current_state`;
- an ego state: `rear_axle.x/y/heading`, `center`, `dynamic_car_state.speed`, `dynamic_car_state.rear_axle_velocity_2d.x/y`,
  `time_point.time_us`;
- an observation: `tracked_objects.tracked_objects`, each with `token`, `tracked_object_type.name`, `center.x/y/heading`,
  `velocity.x/y`, `box.length/width`.

`initialize` gets `route`, the points of the path to follow, and `map`, the features of the scene's map, in place of nuPlan's own
map interface: a planner that asks nuPlan's map needs its own translation of these.

A trajectory may be a list of states, or an object with `get_sampled_trajectory()`; each state has `rear_axle`, or is one
`(x, y, heading)` of the rear axle in the scene's frame, 0.1 s apart, the present one first.
"""

import math
from types import SimpleNamespace as Namespace

DT = 0.1
TYPES = {"vehicle": "VEHICLE", "pedestrian": "PEDESTRIAN", "cyclist": "BICYCLE", "object": "GENERIC_OBJECT"}


def _pose(x, y, heading):
    return Namespace(x=x, y=y, heading=heading)


def _ego_state(fields, car):
    (x, y), heading, (vx, vy) = fields["ego"]["position"], fields["ego"]["heading"], fields["ego"]["velocity"]
    cos, sin = math.cos(heading), math.sin(heading)
    along, across = vx * cos + vy * sin, vy * cos - vx * sin
    # The velocity of the rear axle, in the car's frame.
    across -= car.rear_axle * fields["ego"]["yaw_rate"]
    return Namespace(
        center=_pose(x, y, heading),
        rear_axle=_pose(x - car.rear_axle * cos, y - car.rear_axle * sin, heading),
        dynamic_car_state=Namespace(
            speed=math.hypot(along, across),
            rear_axle_velocity_2d=Namespace(x=along, y=across),
            angular_velocity=fields["ego"]["yaw_rate"],
        ),
        time_point=Namespace(time_us=int(round(fields["t"] * 1e6))),
    )


def _observation(fields):
    objects = [
        Namespace(
            token=agent["id"],
            tracked_object_type=Namespace(name=TYPES[agent["type"]]),
            center=_pose(*agent["position"], agent["heading"]),
            velocity=Namespace(x=agent["velocity"][0], y=agent["velocity"][1]),
            box=Namespace(length=agent["size"][0], width=agent["size"][1]),
        )
        for agent in fields["agents"]
    ]
    return Namespace(tracked_objects=Namespace(tracked_objects=objects))


def _states(trajectory):
    if hasattr(trajectory, "get_sampled_trajectory"):
        trajectory = trajectory.get_sampled_trajectory()
    for state in trajectory:
        pose = getattr(state, "rear_axle", state)
        yield (pose.x, pose.y, pose.heading) if hasattr(pose, "x") else tuple(pose)


def from_nuplan(planner):
    """A planner for `serve` from one of nuPlan."""

    class NuPlan:
        def reset(self, scene, seed):
            self.steps = 0
            if hasattr(planner, "initialize"):
                planner.initialize(Namespace(route=scene.route.points, map=scene.map, seed=seed))

        def act(self, obs):
            car = obs.scene.car
            states = [_ego_state(fields, car) for fields in obs.history]
            history = Namespace(
                ego_states=states,
                observations=[_observation(fields) for fields in obs.history],
                current_state=(states[-1], _observation(obs.fields)),
                sample_interval=DT,
            )
            iteration = Namespace(index=self.steps, time_s=obs.t)
            self.steps += 1
            trajectory = planner.compute_planner_trajectory(Namespace(iteration=iteration, history=history))
            cos, sin = math.cos(obs.ego.heading), math.sin(obs.ego.heading)
            rows = []
            for x, y, heading in list(_states(trajectory))[1:]:
                # From the rear axle to the centre, then into the car's frame.
                dx = x + car.rear_axle * math.cos(heading) - obs.ego.x
                dy = y + car.rear_axle * math.sin(heading) - obs.ego.y
                turn = math.remainder(heading - obs.ego.heading, math.tau)
                rows.append([dx * cos + dy * sin, dy * cos - dx * sin, turn])
            return rows

    return NuPlan()

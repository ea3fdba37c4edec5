"""Put your planner into the ego's seat of `sage`. Copy this file beside your planner; it needs Python 3.8 and nothing else.

    from sage_planner import serve

    class MyPlanner:
        def act(self, obs):
            return 0.0, 0.2            # steer and throttle, both in [-1, 1], steer positive to the left

    serve(MyPlanner())

A planner has `act(obs)` and may have `reset(scene, seed)`, which is called before each drive. `act` returns

- `(steer, throttle)`,
- a plan: a list (or array) of rows `[x, y]`, `[x, y, heading]` or `[x, y, heading, speed]` in the car's frame (x ahead,
  y to the left), the first 0.1 s ahead and one every 0.1 s (`obs.to_car(x, y)` takes a point of the scene there); or
- a dict as the protocol has it, such as `{"acceleration": 1.0, "steering_angle": 0.02}` or `{"plan": rows, "again": 5}`; with
  `"follow": "exact"` the car takes the poses of a plan as they are.

It may have `wants_goal = True`, to be told as `scene.goal` where its recording ends, and `follows = ("plan", "mpc")`, names of your own for ways of following
its plans, of which `scene.follow` is the one to use.

Units: metres, seconds, radians; positions in the frame of the scene. `docs/testing-a-driver.md` describes all fields.
"""

import json
import math
import os
import sys
from collections import deque

try:
    import numpy
except ImportError:
    numpy = None  # type: ignore[assignment]

PROTOCOL = 1
#: Number of frames that `Observation.history` holds, this one included.
HISTORY = 10
#: Road users farther than this are no leaders, metres.
REACH = 80.0
#: Space to each side of the car that belongs to its path, metres.
MARGIN = 0.3


class Car:
    """Size and limits of the driven car: metres, rad, m/s2, m/s."""

    def __init__(self, fields):
        self.length = fields["length"]
        self.width = fields["width"]
        #: Distances from the centre to the axles.
        self.front_axle = fields["front_axle"]
        self.rear_axle = fields["rear_axle"]
        self.max_steering_angle = fields["max_steering_angle"]
        #: At full throttle, at full brake, and without either, m/s2, all positive.
        self.max_acceleration = fields["max_acceleration"]
        self.max_deceleration = fields["max_deceleration"]
        self.rolling_deceleration = fields["rolling_deceleration"]
        self.max_speed = fields["max_speed"]

    def __repr__(self):
        return f"<Car: {self.length:.1f} m x {self.width:.1f} m>"

    def throttle_for(self, acceleration):
        """Throttle or brake for an acceleration on a straight road."""
        if acceleration >= 0.0:
            throttle = acceleration / self.max_acceleration
        elif acceleration > -self.rolling_deceleration:
            throttle = 0.0
        else:
            throttle = acceleration / self.max_deceleration
        return min(max(throttle, -1.0), 1.0)


class Route:
    """The path to follow, a polyline. Before its start and beyond its end it goes straight on."""

    def __init__(self, points):
        self.points = [tuple(point) for point in points]
        # Start, direction, length, length before, heading of each leg.
        self.legs = []
        before = 0.0
        for (ax, ay), (bx, by) in zip(self.points, self.points[1:]):
            length = math.hypot(bx - ax, by - ay)
            tx, ty = (bx - ax) / length, (by - ay) / length
            self.legs.append((ax, ay, tx, ty, length, before, math.atan2(ty, tx)))
            before += length
        self.length = before

    def __repr__(self):
        return f"<Route: {self.length:.0f} m, {len(self.points)} points>"

    def locate(self, x, y):
        """Distance along the route and across it (positive to the right) of a point."""
        best, found = math.inf, (0.0, 0.0)
        last = len(self.legs) - 1
        for k, (ax, ay, tx, ty, length, before, _) in enumerate(self.legs):
            dx, dy = x - ax, y - ay
            along = dx * tx + dy * ty
            across = dx * ty - dy * tx
            nearest = along
            if k > 0 and nearest < 0.0:
                nearest = 0.0
            if k < last and nearest > length:
                nearest = length
            away = math.hypot(along - nearest, across)
            if away < best:
                best, found = away, (before + nearest, math.copysign(away, across))
        return found

    def _leg(self, along):
        low, high = 0, len(self.legs) - 1
        while low < high:
            middle = (low + high) // 2
            leg = self.legs[middle]
            if leg[5] + leg[4] <= along:
                low = middle + 1
            else:
                high = middle
        return self.legs[low]

    def point(self, along, across=0.0):
        """Position at a distance along the route and across it (positive to the right)."""
        ax, ay, tx, ty, _, before, _ = self._leg(along)
        along -= before
        return ax + along * tx + across * ty, ay + along * ty - across * tx

    def heading(self, along):
        """Heading of the route at a distance along it."""
        return self._leg(along)[6]


class Scene:
    """What is known before a drive: `id`, `route`, `car`, `map` (a list of dicts), `lights` (on the route), `other_lights`,
    `route_lanes` (ids of the lanes that the route follows)."""

    def __init__(self, fields):
        self.id = fields["scene"]
        self.route = Route(fields["route"])
        self.car = Car(fields["ego"])
        self.map = fields["map"]
        self.lights = fields["lights"]
        self.other_lights = fields.get("other_lights", [])
        self.route_lanes = fields.get("route_lanes", [])
        self.goal = fields.get("goal")
        self.follow = fields.get("follow")

    @property
    def all_lights(self):
        """The lights on the route, then the others."""
        return self.lights + self.other_lights


class Agent:
    """Another road user now: `id`, `type`, `length` and `width` (metres), centre `x`, `y`, `heading` (rad), velocity `vx`, `vy` (m/s)."""

    __slots__ = ("id", "type", "length", "width", "x", "y", "heading", "vx", "vy")

    def __init__(self, fields):
        self.id = fields["id"]
        self.type = fields["type"]
        self.length, self.width = fields["size"]
        self.x, self.y = fields["position"]
        self.heading = fields["heading"]
        self.vx, self.vy = fields["velocity"]

    def __repr__(self):
        return f"<Agent '{self.id}': {self.type} at ({self.x:.1f}, {self.y:.1f}), {self.speed:.1f} m/s>"

    @property
    def speed(self):
        """Speed, m/s."""
        return math.hypot(self.vx, self.vy)

    def corners(self):
        cos, sin = math.cos(self.heading), math.sin(self.heading)
        half_l, half_w = 0.5 * self.length, 0.5 * self.width
        return [
            (self.x + a * half_l * cos - b * half_w * sin, self.y + a * half_l * sin + b * half_w * cos)
            for a, b in ((1, 1), (-1, 1), (-1, -1), (1, -1))
        ]


class Ego:
    """The driven car now: centre `x`, `y` (metres), `heading` (rad), velocity `vx`, `vy` (m/s), `yaw_rate` (rad/s); in the step
    before, `acceleration` (m/s2, forward) and `steering_angle` (rad)."""

    __slots__ = ("x", "y", "heading", "vx", "vy", "yaw_rate", "acceleration", "steering_angle")

    def __init__(self, fields):
        self.x, self.y = fields["position"]
        self.heading = fields["heading"]
        self.vx, self.vy = fields["velocity"]
        self.yaw_rate = fields["yaw_rate"]
        self.acceleration = fields.get("acceleration", 0.0)
        self.steering_angle = fields.get("steering_angle", 0.0)

    def __repr__(self):
        return f"<Ego at ({self.x:.1f}, {self.y:.1f}), heading {self.heading:.2f}, {self.speed:.1f} m/s>"

    @property
    def speed(self):
        """Forward speed, m/s."""
        return self.vx * math.cos(self.heading) + self.vy * math.sin(self.heading)


class Observation:
    """What the driver sees before a step of 0.1 s."""

    def __init__(self, fields, scene, history):
        self.fields = fields
        self.scene = scene
        #: Time since the start of the drive.
        self.t = fields["t"]
        self.ego = Ego(fields["ego"])
        #: States of `scene.lights` now: "red", "yellow", "green", "flashing red" or "unknown".
        self.lights = fields["lights"]
        #: States of `scene.other_lights`.
        self.other_lights = fields.get("other_lights", [])
        #: The messages of the last ten frames, the oldest first, this one last.
        self.history = history
        self._agents = None

    @property
    def all_lights(self):
        """States of `scene.all_lights`."""
        return self.lights + self.other_lights

    @property
    def agents(self):
        """The other road users, the nearest first."""
        if self._agents is None:
            self._agents = [Agent(fields) for fields in self.fields["agents"]]
        return self._agents

    @property
    def agent_rows(self):
        """A row `[x, y, heading, vx, vy, length, width]` for each of `agents`: an array where NumPy is installed, else
        lists."""
        rows = [[a.x, a.y, a.heading, a.vx, a.vy, a.length, a.width] for a in self.agents]
        return rows if numpy is None else numpy.array(rows, dtype=float).reshape(-1, 7)

    def vector(self):
        """The 101 numbers that learning drivers see; ask for them with `serve(planner, observation=True)`."""
        numbers = self.fields["observation"]
        return numbers if numpy is None else numpy.asarray(numbers, dtype=numpy.float32)

    def leader(self, route, across=None):
        """Gap and speed of the nearest road user ahead on a route, bumper to bumper, or None.

        Its speed is the part along the route. `across` is the offset of the path from the route, positive to the right;
        without it the car's own.
        """
        car, ego = self.scene.car, self.ego
        place, own = route.locate(ego.x, ego.y)
        across = own if across is None else across
        x, y = route.point(place, across)
        half = 0.5 * car.width + MARGIN
        best = None
        for agent in self.agents:
            if (agent.x - x) ** 2 + (agent.y - y) ** 2 > REACH * REACH:
                continue
            along, aside = route.locate(agent.x, agent.y)
            radius = 0.5 * math.hypot(agent.length, agent.width)
            if along <= place or abs(aside - across) > half + radius:
                continue
            corners = [route.locate(*corner) for corner in agent.corners()]
            sides = [side - across for _, side in corners]
            if all(side < -half for side in sides) or all(side > half for side in sides):
                continue
            gap = min(rear for rear, _ in corners) - (place + 0.5 * car.length)
            heading = route.heading(along)
            speed = agent.vx * math.cos(heading) + agent.vy * math.sin(heading)
            if best is None or gap < best[0]:
                best = (gap, speed)
        return best

    def to_car(self, x, y):
        """A point of the scene in the car's frame: ahead and to the left."""
        cos, sin = math.cos(self.ego.heading), math.sin(self.ego.heading)
        dx, dy = x - self.ego.x, y - self.ego.y
        return [dx * cos + dy * sin, dy * cos - dx * sin]

    def leader_gap(self, route):
        """Distance to the road user ahead on a route, bumper to bumper; infinite if there is none."""
        leader = self.leader(route)
        return math.inf if leader is None else leader[0]

    def steer_to(self, route, ahead):
        """Steering in [-1, 1] that leads to the route, `ahead` metres ahead of the car (pure pursuit)."""
        car, ego = self.scene.car, self.ego
        along, _ = route.locate(ego.x, ego.y)
        x, y = route.point(along + ahead)
        cos, sin = math.cos(ego.heading), math.sin(ego.heading)
        dx = x - (ego.x - car.rear_axle * cos)
        dy = y - (ego.y - car.rear_axle * sin)
        left = dy * cos - dx * sin
        squared = max(dx * dx + dy * dy, 1.0)
        angle = math.atan(2.0 * (car.front_axle + car.rear_axle) * left / squared)
        return min(max(angle / car.max_steering_angle, -1.0), 1.0)


def from_gym(model, normalize=None):
    """A planner from a policy of Gymnasium or Stable-Baselines3 that was trained on MetaDrive's observation: `predict` gets
    the 101 numbers and returns steer and throttle. `normalize` is the `VecNormalize` that it was trained behind, if it was; that
    of a model which still has its environment is known. Serve it with `observation=True`."""
    if normalize is None and hasattr(model, "get_vec_normalize_env"):
        normalize = model.get_vec_normalize_env()

    class Gym:
        def act(self, obs):
            seen = obs.vector() if normalize is None else normalize.normalize_obs(obs.vector())
            action = model.predict(seen, deterministic=True)
            return action[0] if isinstance(action, tuple) else action

    return Gym()


def from_metadrive(policy):
    """A planner from an object with MetaDrive's `act(agent_id)`, which returns steer and throttle, and perhaps `reset()`.
    It gets the observation as `policy.observation` before each step."""

    class MetaDrive:
        def reset(self, scene, seed):
            if hasattr(policy, "reset"):
                policy.reset()

        def act(self, obs):
            policy.observation = obs
            return policy.act("default_agent")

    return MetaDrive()


def _answer(action):
    """What a planner returned, as the protocol has it."""
    if isinstance(action, dict):
        answer = {key: _plain(value) for key, value in action.items()}
        _refuse_infinite(answer)
        return answer
    rows = _plain(action)
    _refuse_infinite(rows)
    if not isinstance(rows, list) or not rows:
        raise TypeError(f"act returned {action!r}; expected (steer, throttle), rows of a plan, or a dict")
    if isinstance(rows[0], list):
        return {"plan": rows}
    if len(rows) != 2:
        raise TypeError(f"act returned {len(rows)} numbers; expected steer and throttle")
    return {"steer": rows[0], "throttle": rows[1]}


def _refuse_infinite(value, place="act returned"):
    """JSON has no NaN and no infinity."""
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"{place} {value}; expected finite numbers")
    if isinstance(value, dict):
        for key, item in value.items():
            _refuse_infinite(item, f"act returned, as `{key}`,")
    if isinstance(value, list):
        for k, item in enumerate(value):
            _refuse_infinite(item, f"act returned, in row {k}," if isinstance(item, list) else place)


def _plain(value):
    """Lists and floats in place of arrays and their numbers."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    return value


_answers = None


def keep_standard_output():
    """The file of answers. From the first call on, whatever else writes to the standard output goes to the standard error."""
    global _answers
    if _answers is None:
        _answers = os.fdopen(os.dup(1), "w", encoding="utf-8", newline="\n")
        os.dup2(2, 1)
        sys.stdout = sys.stderr
    return _answers


# `sage` sets this for its planners: libraries that are imported after this module may print when they are loaded.
if os.environ.get("SAGE_PLANNER"):
    keep_standard_output()


def serve(planner, observation=False):
    """Answers `sage` until it closes the input. What the planner prints goes to the log of the run."""
    out = keep_standard_output()
    hello = {"hello": PROTOCOL, "observation": observation}
    if getattr(planner, "wants_goal", False) is True:
        hello["goal"] = True
    if getattr(planner, "follows", ()):
        hello["follows"] = list(planner.follows)
    encode = json.JSONEncoder(allow_nan=False, separators=(",", ":")).encode
    scene, history = None, deque(maxlen=HISTORY)
    for line in sys.stdin:
        message = json.loads(line)
        if "step" in message:
            fields = message["step"]
            history.append(fields)
            answer = _answer(planner.act(Observation(fields, scene, history)))
            answer["t"] = fields["t"]  # says which step it answers
        elif "reset" in message:
            scene = Scene(message["reset"])
            history.clear()
            if hasattr(planner, "reset"):
                planner.reset(scene, message["reset"]["seed"])
            answer = {"ready": True}
        else:
            answer = hello
        out.write(encode(answer) + "\n")
        out.flush()

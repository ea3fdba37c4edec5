"""The glue of FISS+ against a double of `fiss_planner`, and a drive with the real one where it is installed: python3 test_fiss.py"""

import importlib.util
import json
import os
import subprocess
import sys
import tempfile

HERE = os.path.dirname(os.path.abspath(__file__))

DOUBLE = '''
import sys
from types import SimpleNamespace as Any

LineType = Any(UNKNOWN="unknown", ROAD_EDGE="edge", SOLID="solid", DASHED="dashed")
MapLane, VehicleParams = Any, Any

class RoadMap:
    def __init__(self):
        self.stop_lines = []
    def add_lane(self, lane):
        kept = {k: v for k, v in vars(lane).items() if k not in ("centerline", "left", "right")}
        print("LANE", kept, lane.left[0].tolist(), lane.right[0].tolist(), file=sys.stderr)
    def add_stop_line(self, line):
        print("STOP", line.id, line.lane, line.s, file=sys.stderr)
        self.stop_lines.append(line)
    def finalize(self):
        pass

def StopLine(number, lane, s, active):
    return Any(id=number, lane=lane, s=s)

def LocalPlannerConfig():
    return Any(planner=Any(sampling=Any(max_t=5.0)), stitching=Any(enabled=True))

def EgoState(x, y, yaw, v, a, kappa):
    return Any(x=x, y=y, yaw=yaw, v=v, a=a)

class Plan:
    def __init__(self, ego):
        self.ego = ego
    def __len__(self):
        return 50
    def sample(self, t):
        # Its heading jumps, as where a car hardly moves.
        return Any(x=self.ego.x + self.ego.v * t, y=self.ego.y, yaw=2.0, v=self.ego.v)

class LocalPlanner:
    def __init__(self, config, vehicle):
        print("STITCHING", config.stitching.enabled, file=sys.stderr)
    def set_map(self, road, route):
        print("ROUTE", route, file=sys.stderr)
    def set_stop_line_active(self, number, active):
        print("LIGHT", number, active, file=sys.stderr)
    def step(self, t, ego, obstacles):
        print("OBSTACLES", [o[0] for o in obstacles], file=sys.stderr)
        return Any(trajectory=Plan(ego), emergency=False, fallback=True, degraded=False, target_speed=5.0,
                   stats=Any(lead=Any(id=0, gap=12.0)))

def make_controller(name, vehicle):
    return Any(compute=lambda ego, plan, t: Any(accel=-1.0, steer=0.1))

def predict_lane_following(road, number, *body):
    return (number, "lane")

def predict_constant_velocity(number, *body):
    return (number, "straight")
'''


def lane(name, y, **more):
    stretches = {"left": [], "right": []}
    points = [[float(x), y, 0.0] for x in range(0, 101, 10)]
    width = [[1.8, None]] * len(points)
    fields = {"id": name, "type": "LANE_SURFACE_STREET", "points": points, "speed_limit": None, "entries": [], "exits": []}
    return {**fields, "width": width, "neighbors": dict(stretches), "boundaries": dict(stretches), **more}


def messages(follow):
    beside = {"lane": "b", "from": 0, "to": 10, "other_from": 0, "other_to": 10, "line": "ROAD_LINE_BROKEN_SINGLE_WHITE"}
    oncoming = {**beside, "lane": "a", "line": "ROAD_LINE_SOLID_DOUBLE_YELLOW"}
    lanes = [
        lane("a", 0.0, neighbors={"left": [beside], "right": []}),
        lane("b", 3.5, neighbors={"left": [], "right": [oncoming]}),
        {"id": "edge", "type": "ROAD_EDGE_BOUNDARY", "points": [[0, 5, 0], [100, 5, 0]]},
    ]
    car = {
        "length": 4.5, "width": 1.9, "front_axle": 1.0, "rear_axle": 1.4, "max_steering_angle": 0.7,
        "max_acceleration": 3.0, "max_deceleration": 23.0, "rolling_deceleration": 0.4, "max_speed": 22.0,
    }
    reset = {
        "scene": "s", "seed": 3, "route": [[0, 0], [100, 0]], "map": lanes, "ego": car, "route_lanes": ["a"], "follow": follow,
        "lights": [{"lane": "a", "along": 50.0, "point": [48.0, 0.0]}], "other_lights": [{"lane": "b", "point": None}],
    }
    agent = {"id": "7", "type": "vehicle", "size": [4.5, 1.9], "position": [30.0, 0.0], "heading": 0.0, "velocity": [4.0, 0.0]}
    ego = {"position": [0.0, 0.0], "heading": 0.0, "velocity": [5.0, 0.0], "yaw_rate": 0.0, "acceleration": 0.5, "steering_angle": 0.0}
    step = {"t": 0.0, "ego": ego, "agents": [agent], "lights": ["yellow"], "other_lights": ["green"]}
    return [{"hello": 1, "dt": 0.1}, {"reset": reset}, {"step": step}]


def answers(follow, path="", *arguments):
    text = "".join(json.dumps(message) + "\n" for message in messages(follow))
    command = [sys.executable, os.path.join(HERE, "fiss.py"), *arguments]
    env = {**os.environ, "PYTHONPATH": path, "SAGE_PLANNER": "1"}
    done = subprocess.run(command, input=text, capture_output=True, text=True, timeout=300, env=env)
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()], done.stderr


def with_double():
    with tempfile.TemporaryDirectory() as folder:
        with open(os.path.join(folder, "fiss_planner.py"), "w") as file:
            file.write(DOUBLE)
        (hello, ready, exact), told = answers("exact", folder, "--set", "stitching.enabled=False")
        assert hello["follows"] == ["exact", "plan", "mpc"] and ready == {"ready": True}
        assert exact["follow"] == "exact" and len(exact["plan"]) == 40
        x, y, heading, speed = exact["plan"][0]
        # No further than the wheels turn it.
        assert abs(x - 0.5) < 1e-9 and y == 0.0 and speed == 5.0 and 0.0 < heading < 0.2, exact["plan"][0]
        first, second = [line for line in told.splitlines() if line.startswith("LANE")]
        assert "'left_neighbor': 2, 'can_change_left': True" in first and first.endswith("[0.0, 1.8] [0.0, -1.75]"), first
        assert "'right_neighbor': 1, 'can_change_right': False" in second, second
        for line in ("STITCHING False", "ROUTE [1]", "STOP 0 1 50.0", "STOP 1 2 0.0", "LIGHT 0 True", "LIGHT 1 False", "OBSTACLES [0]"):
            assert line in told.splitlines(), (line, told)
        assert "plan" in answers("plan", folder)[0][2] and "follow" not in answers("plan", folder)[0][2]
        assert answers("mpc", folder)[0][2]["acceleration"] == -1.0


def with_the_real_one():
    (_, _, step), told = answers("exact")
    rows = step["plan"]
    assert len(rows) == 40 and all(-1.0 < y < 4.5 for _, y, _, _ in rows) and rows[-1][0] > 10.0, rows
    assert "lead 7" in told, told


if __name__ == "__main__":
    if importlib.util.find_spec("numpy") is None:
        print("left out: the glue of FISS+ needs numpy")
    else:
        with_double()
        if importlib.util.find_spec("fiss_planner") is None:
            print("left out: fiss-planner is not installed (pip install -r requirements.txt)")
        else:
            with_the_real_one()

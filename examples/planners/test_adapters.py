"""Adapters against doubles, and against the real packages where they are installed: python3 test_adapters.py"""

import json
import math
import os
import subprocess
import sys
import tempfile

HERE = os.path.dirname(os.path.abspath(__file__))

RESET = {
    "scene": "s", "seed": 3, "route": [[0, 0], [100, 0]], "map": [],
    "ego": {
        "length": 4.5, "width": 1.9, "front_axle": 1.0, "rear_axle": 1.4, "max_steering_angle": 0.7,
        "max_acceleration": 3.0, "max_deceleration": 23.0, "rolling_deceleration": 0.4, "max_speed": 22.0,
    },
    "lights": [],
}


def step(t, x=0.0, speed=5.0, heading=0.0):
    velocity = [speed * math.cos(heading), speed * math.sin(heading)]
    agent = {"id": "7", "type": "vehicle", "size": [4.5, 1.9], "position": [x + 20.0, 0.0], "heading": 0.0, "velocity": [4.0, 0.0]}
    ego = {"position": [x, 0.0], "heading": heading, "velocity": velocity, "yaw_rate": 0.0}
    return {"step": {"t": t, "ego": ego, "agents": [agent], "lights": [], "observation": [0.5] * 101}}


def answers(program, steps):
    """What a planner answers to hello, a reset and some steps."""
    lines = [{"hello": 1, "dt": 0.1}, {"reset": RESET}, *steps]
    with tempfile.NamedTemporaryFile("w", suffix=".py", dir=HERE, delete=False) as file:
        file.write(program)
    try:
        text = "".join(json.dumps(line) + "\n" for line in lines)
        done = subprocess.run([sys.executable, file.name], input=text, capture_output=True, text=True, timeout=300)
    finally:
        os.unlink(file.name)
    assert done.returncode == 0, done.stderr
    found = [json.loads(line) for line in done.stdout.splitlines()]
    for message, answer in zip(lines, found):
        if "step" in message:
            assert answer.pop("t") == message["step"]["t"]
    return found


def nuplan():
    program = """
from nuplan_adapter import from_nuplan
from sage_planner import serve

class Straight:
    def initialize(self, initialization):
        assert len(initialization.route) == 2
    def compute_planner_trajectory(self, current):
        ego, observation = current.history.current_state
        assert len(current.history.ego_states) == min(current.iteration.index + 1, 10)
        other = observation.tracked_objects.tracked_objects[0]
        assert other.tracked_object_type.name == "VEHICLE" and other.box.length == 4.5
        v = ego.dynamic_car_state.speed
        return [(ego.rear_axle.x + 0.1 * k * v, ego.rear_axle.y, 0.0) for k in range(41)]

serve(from_nuplan(Straight()))
"""
    hello, ready, *plans = answers(program, [step(0.1 * k, 0.5 * k) for k in range(12)])
    assert hello == {"hello": 1, "observation": False} and ready == {"ready": True}
    for plan in plans:
        rows = plan["plan"]
        assert len(rows) == 40
        assert abs(rows[0][0] - 0.5) < 1e-9 and abs(rows[39][0] - 20.0) < 1e-9 and rows[0][1] == 0.0
    # A car that is turned by 0.3: the same trajectory in its frame.
    _, _, plan = answers(program, [step(0.0, heading=0.3)])
    x, y, turn = plan["plan"][39]
    assert abs(turn + 0.3) < 1e-9
    ahead = 1.4 + 20.0 - 1.4 * math.cos(0.3), -1.4 * math.sin(0.3)
    assert abs(x - (ahead[0] * math.cos(0.3) + ahead[1] * math.sin(0.3))) < 1e-9
    assert abs(y - (ahead[1] * math.cos(0.3) - ahead[0] * math.sin(0.3))) < 1e-9


def gym():
    double = """
from sage_planner import from_gym, serve
class Model:
    def predict(self, observation, deterministic):
        assert deterministic and len(observation) == 101 and abs(observation[0] - 0.5) < 1e-9
        return [float(observation[0]), -0.25], None
serve(from_gym(Model()), observation=True)
"""
    assert answers(double, [step(0.0)])[2] == {"steer": 0.5, "throttle": -0.25}


def metadrive():
    double = """
from sage_planner import from_metadrive, serve
class Policy:
    def act(self, agent_id):
        return [0.1, self.observation.ego.speed / 10.0]
serve(from_metadrive(Policy()))
"""
    assert answers(double, [step(0.0)])[2] == {"steer": 0.1, "throttle": 0.5}


def real_gym():
    try:
        import stable_baselines3  # noqa: F401
    except ImportError:
        return "stable-baselines3 is not installed"
    program = """
import gymnasium, numpy
from stable_baselines3 import PPO
from sage_planner import from_gym, serve
class Space(gymnasium.Env):
    observation_space = gymnasium.spaces.Box(-1.0, 1.0, (101,), numpy.float32)
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (2,), numpy.float32)
    def reset(self, seed=None, options=None):
        return numpy.zeros(101, numpy.float32), {}
    def step(self, action):
        return numpy.zeros(101, numpy.float32), 0.0, True, False, {}
serve(from_gym(PPO("MlpPolicy", Space(), seed=0)), observation=True)
"""
    first, second = answers(program, [step(0.0), step(0.1)])[2:]
    assert set(first) == {"steer", "throttle"} and first == second


def real_metadrive():
    try:
        import metadrive  # noqa: F401
    except ImportError:
        return "metadrive is not installed"
    program = """
from metadrive.policy.base_policy import BasePolicy
from sage_planner import from_metadrive, serve
class Policy(BasePolicy):
    def __init__(self):
        pass
    def reset(self):
        self.count = 0
    def act(self, *args, **kwargs):
        self.count += 1
        return [0.0, 0.1 * self.count]
serve(from_metadrive(Policy()))
"""
    first, second = answers(program, [step(0.0), step(0.1)])[2:]
    assert first == {"steer": 0.0, "throttle": 0.1} and abs(second["throttle"] - 0.2) < 1e-12


for test in [nuplan, gym, metadrive, real_gym, real_metadrive]:
    missing = test()
    print(f"left out: {test.__name__}: {missing}" if missing else f"passed: {test.__name__}")

"""The glue of openpilot's MPC against a double, and with the real one where OPENPILOT names a checkout that is built: python3
test_openpilot.py"""

import json
import os
import shutil
import subprocess
import sys

HERE = os.path.dirname(os.path.abspath(__file__))

DOUBLE = """
import runpy, sys, types

class LongitudinalMpc:
    source = "double"
    def set_accel_limits(self, least, most):
        self.most = most
    def set_cur_state(self, v, a):
        pass
    def update(self, car, radar, set_speed):
        lead = radar.leadOne
        a = lead.aLeadK - lead.aLeadTau if lead.status else min(self.most, set_speed - 13.0)
        self.a_solution = [a, a, a]

module = types.SimpleNamespace(LongitudinalMpc=LongitudinalMpc, T_IDXS=[0.0, 0.06, 10.0])
sys.modules["mpc"] = types.SimpleNamespace(acados_template=lambda checkout: None, load=lambda checkout, template: module)
sys.argv = [sys.argv[1], "checkout"]
runpy.run_path(sys.argv[0], run_name="__main__")
"""


def messages(speeds, gap=30.0, own=10.0):
    """A drive behind a car, if it has speeds, else alone; the road's limit is 13.5 m/s."""
    car = {
        "length": 4.5, "width": 1.9, "front_axle": 1.0, "rear_axle": 1.4, "max_steering_angle": 0.7,
        "max_acceleration": 3.0, "max_deceleration": 23.0, "rolling_deceleration": 0.4, "max_speed": 30.0,
    }
    lane = {"id": "a", "type": "LANE_SURFACE_STREET", "points": [[0, 0, 0], [200, 0, 0]], "speed_limit": 13.5}
    fields = {"scene": "s", "seed": 3, "route": [[0, 0], [200, 0]], "map": [lane], "ego": car, "route_lanes": ["a"], "lights": []}
    told = [{"reset": fields}]
    for k, speed in enumerate(speeds):
        body = {"id": "7", "type": "vehicle", "size": [4.5, 1.9], "position": [gap + 4.5 + k, 0.0], "heading": 0.0, "velocity": [speed, 0.0]}
        ego = {"position": [k * 1.0, 0.2], "heading": 0.0, "velocity": [own, 0.0], "yaw_rate": 0.0, "acceleration": 0.0, "steering_angle": 0.0}
        told.append({"step": {"t": k / 10, "ego": ego, "agents": [] if speed is None else [body], "lights": []}})
    return told


def answers(drives, command):
    told = [{"hello": 1, "dt": 0.1}] + [message for drive in drives for message in drive]
    text = "".join(json.dumps(message) + "\n" for message in told)
    env = {**os.environ, "SAGE_PLANNER": "1"}
    done = subprocess.run([sys.executable, *command], input=text, capture_output=True, text=True, timeout=300, env=env)
    assert done.returncode == 0, done.stderr
    steps = [json.loads(line) for line in done.stdout.splitlines()]
    assert steps[0]["hello"] == 1
    groups = []
    for answer in steps[1:]:
        if answer == {"ready": True}:
            groups.append([])
        else:
            groups[-1].append(answer)
    return groups, done.stderr


def with_double():
    command = ["-c", DOUBLE, os.path.join(HERE, "openpilot.py")]
    free, braking = messages([None, None]), messages([10.0, 9.0, 8.0, 8.0])
    (alone, first, again), told = answers([free, braking, braking], command)
    assert [answer["acceleration"] for answer in alone] == [0.5, 0.5], alone
    assert all(answer["steering_angle"] < 0.0 for answer in alone), "it is left of its route"
    # The leader's acceleration is smoothed, decays in the prediction, and is forgotten with the drive.
    found = [round(answer["acceleration"], 6) for answer in first]
    assert found == [-1.5, round(-3.0 - 1.35, 6), round(-5.1 - 1.215, 6), round(-3.57 - 1.0935, 6)], found
    assert first == again
    assert "of 13.5, no lead, by double" in told and "lead 30.0 m at 9.0 m/s -3.0 m/s2" in told, told


def with_the_real_one(checkout):
    command = [os.path.join(HERE, "openpilot.py"), checkout]
    far, near = messages([None] * 10), messages([10.0 - 0.8 * k for k in range(10)], gap=20.0)
    (alone, first, again), told = answers([far, near, near], command)
    assert 0.0 < alone[-1]["acceleration"] < 1.3, alone
    assert first[-1]["acceleration"] < -1.0 and first == again, first


if __name__ == "__main__":
    with_double()
    checkout = os.environ.get("OPENPILOT")
    if not checkout:
        print("left out: OPENPILOT names no checkout of openpilot")
    elif not os.path.exists(os.path.join(checkout, "sage-mpc", "long.json")):
        tools = [tool for tool in ("gcc", "make") if shutil.which(tool) is None]
        print(f"left out: {checkout} is not built (sh build.sh CHECKOUT)" + "".join(f"; {tool} is not installed" for tool in tools))
    else:
        with_the_real_one(checkout)

"""The glue of PufferDrive's policy with weights of zeros, and with the real ones where PUFFERDRIVE names the file of its version 1.0: python3
test_pufferdrive.py"""

import importlib.util
import json
import math
import os
import pickle
import subprocess
import sys
import tempfile

HERE = os.path.dirname(os.path.abspath(__file__))


def messages(goal=60.0):
    car = {
        "length": 5.0, "width": 2.0, "front_axle": 1.0, "rear_axle": 1.4, "max_steering_angle": 0.7,
        "max_acceleration": 3.0, "max_deceleration": 23.0, "rolling_deceleration": 0.4, "max_speed": 30.0,
    }
    lane = {"id": "a", "type": "LANE_SURFACE_STREET", "points": [[float(x), 0.0, 0.0] for x in range(0, 201, 5)]}
    edge = {"id": "b", "type": "ROAD_EDGE_BOUNDARY", "points": [[0.0, 4.0, 0.0], [200.0, 4.0, 0.0]]}
    fields = {"scene": "s", "seed": 3, "route": [[0, 0], [200, 0]], "map": [lane, edge], "ego": car, "lights": [], "goal": goal}
    ego = {"position": [10.0, 0.0], "heading": 0.0, "velocity": [8.0, 0.0], "yaw_rate": 0.0}
    body = {"id": "7", "type": "vehicle", "size": [5.0, 2.0], "position": [30.0, 0.0], "heading": 0.0, "velocity": [4.0, 0.0]}
    return [{"hello": 1, "dt": 0.1}, {"reset": fields}, {"step": {"t": 0.0, "ego": ego, "agents": [body], "lights": []}}]


def answers(weights, goal=60.0):
    text = "".join(json.dumps(message) + "\n" for message in messages(goal))
    command = [sys.executable, os.path.join(HERE, "pufferdrive.py"), weights]
    done = subprocess.run(command, input=text, capture_output=True, text=True, timeout=300, env={**os.environ, "SAGE_PLANNER": "1"})
    return [json.loads(line) for line in done.stdout.splitlines()], done


def with_zeros(folder):
    import numpy as np

    path = os.path.join(folder, "zeros.bin")
    np.zeros(595_925, np.float32).tofile(path)
    (hello, ready, step), _ = answers(path)
    assert hello["goal"] is True and ready == {"ready": True}
    # Of equal numbers the first: full brake, which its own vehicle halves, and full steering to the right.
    bend = -math.cos(math.tanh(0.5 * math.tan(1.0))) * math.tan(1.0) / 3.5
    angle = math.atan(2.4 * bend / math.sqrt(1.0 - (1.4 * bend) ** 2))
    assert step["acceleration"] == -2.0 and abs(step["steering_angle"] - angle) < 1e-6, step
    (_, _, step), _ = answers(path, goal=11.0)
    assert step["acceleration"] == -3.0, "it has arrived"
    with open(path, "ab") as file:
        file.write(b"more")
    _, done = answers(path)
    assert done.returncode != 0 and "expected the 595925" in done.stderr, done.stderr

    sys.path.insert(0, HERE)
    import pufferdrive

    assert [list(map(int, np.argwhere(pufferdrive.ORDER == k)[0] - 10)) for k in range(6)] == [[0, 0], [1, 0], [1, 1], [0, 1], [-1, 1], [-1, 0]]
    bent = [(float(x), 0.0 if x < 6 else 2.0) for x in range(12)]
    assert pufferdrive.simplified(bent)[:2] == [(0.0, 0.0), (5.0, 0.0)] and pufferdrive.simplified(bent[:9]) == bent[:9]


def own_world(folder, weights):
    import numpy as np

    frames = 91
    track = {"position": [[8.0 * k / 10, 0.0, 0.0] for k in range(frames)], "velocity": [[8.0, 0.0]] * frames, "heading": [0.0] * frames}
    track = {**track, "length": [5.0] * frames, "width": [2.0] * frames, "valid": [True] * frames}
    state = {name: np.array(values) for name, values in track.items()}
    lane = {"type": "LANE_SURFACE_STREET", "polyline": np.array([[float(x), 0.0, 0.0] for x in range(-20, 201, 5)])}
    scene = {"metadata": {"sdc_id": "1"}, "tracks": {"1": {"type": "VEHICLE", "state": state}}, "map_features": {"a": lane}}
    path = os.path.join(folder, "scene.pkl")
    with open(path, "wb") as file:
        pickle.dump(scene, file)
    done = subprocess.run([sys.executable, os.path.join(HERE, "own_world.py"), weights, path], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


if __name__ == "__main__":
    if importlib.util.find_spec("numpy") is None:
        print("left out: PufferDrive's policy needs numpy")
        sys.exit()
    with tempfile.TemporaryDirectory() as folder:
        with_zeros(folder)
        still = os.path.join(folder, "still.bin")
        import numpy as np

        np.zeros(595_925, np.float32).tofile(still)
        assert own_world(folder, still)["succeeded"] == 0
        weights = os.environ.get("PUFFERDRIVE")
        if not weights:
            print("left out: PUFFERDRIVE names no weights")
        else:
            (_, _, step), _ = answers(weights)
            assert abs(step["steering_angle"]) < 0.1, step
            assert own_world(folder, weights)["succeeded"] == 1

"""Whether PufferDrive's policy does what it was trained for: as the vehicle of its own simulator it reaches its goal among recorded cars.

    python3 own_world.py puffer_drive_weights.bin scenes/*.pkl > own.json
    sage bench admit scenes/ --set own_world=puffer=own.json --ego 'puffer=cmd:python3 pufferdrive.py puffer_drive_weights.bin' --out admit

Scenes are MetaDrive's pickles (`sage convert --format metadrive` makes them of others); a pickle may run anything, so of your own alone.
"""

import json
import math
import pickle
import sys
from types import SimpleNamespace

import numpy as np

from pufferdrive import REACHED, PufferDrive, Roads


def car(state, frame):
    x, y = state["position"][frame][:2]
    length, width, heading = (float(np.ravel(state[name])[frame]) for name in ("length", "width", "heading"))
    speed = float(np.hypot(*state["velocity"][frame][:2]))
    return SimpleNamespace(x=float(x), y=float(y), heading=heading, speed=speed, length=length, width=width)


def reaches_goal(policy, scene):
    ego = scene["metadata"]["sdc_id"]
    tracks = {name: track["state"] for name, track in scene["tracks"].items() if track["type"] == "VEHICLE"}
    valid = {name: np.ravel(state["valid"]).astype(bool) for name, state in tracks.items()}
    own, last = tracks[ego], int(np.nonzero(valid[ego])[0][-1])
    features = [{"type": f["type"], "points": f["polyline"]} for f in scene["map_features"].values() if "polyline" in f]
    start, goal = car(own, 0), own["position"][last][:2]
    policy.begin(Roads(features), goal, start.length, start.width)
    state = (start.x, start.y, start.heading, start.speed)
    there = [name for name in tracks if name != ego and valid[name][0]]
    for frame in range(last + 1):
        if math.dist(state[:2], goal) < REACHED:
            return True
        cars = [car(tracks[name], frame) for name in there if valid[name][frame]]
        state = policy.moved(state, *policy.network.action(*policy.seen(state, cars)))
    return math.dist(state[:2], goal) < REACHED


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit("usage: own_world.py WEIGHTS SCENE...")
    policy, reached = PufferDrive(sys.argv[1]), []
    for path in sys.argv[2:]:
        with open(path, "rb") as file:
            reached.append(reaches_goal(policy, pickle.load(file)))
        print(f"{path}: {'reaches' if reached[-1] else 'does not reach'} its goal", file=sys.stderr)
    done = {"simulator": "PufferDrive's vehicle, recorded traffic", "success": "reaches its goal", "scenes": len(reached)}
    print(json.dumps({**done, "succeeded": sum(reached)}))

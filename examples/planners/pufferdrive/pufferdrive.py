"""A driving policy from self-play, PufferDrive's (MIT; its weights, trained on Waymo scenes, are not part of this project).

    sage bench admit scenes/ --out admit --ego 'puffer=cmd:python3 examples/planners/pufferdrive/pufferdrive.py puffer_drive_weights.bin'

Observation, network and vehicle are written anew after `drive.h` and `drive.c` of its version 1.0. It drives to the place where the recording
ends and then brakes. `own_world.py` asks first whether it does so as the vehicle of its own simulator.
"""

import math
import os
import sys

sys.path.insert(0, os.path.join(os.path.dirname(os.path.abspath(__file__)), ".."))
from sage_planner import serve  # first: it keeps the standard output for answers

import numpy as np

STEP, SHRUNK, CELL, VISION, ROADS, CARS, REACHED, BRAKE = 0.1, 0.7, 5.0, 10, 200, 63, 2.0, 3.0
ACCELERATIONS, STEERINGS = np.linspace(-4.0, 4.0, 7), np.linspace(-1.0, 1.0, 13)


def spiral():
    """The order in which the 21 x 21 cells round a car are read."""
    order = np.zeros((2 * VISION + 1, 2 * VISION + 1), dtype=int)
    x = y = found = leg = 0
    while True:
        for _ in range(leg // 2 + 1):
            if abs(x) <= VISION and abs(y) <= VISION:
                order[x + VISION, y + VISION] = found
                found += 1
            if found == order.size:
                return order
            x, y = x + (1, 0, -1, 0)[leg % 4], y + (0, 1, 0, -1)[leg % 4]
        leg += 1


ORDER = spiral()


def simplified(points):
    """A line without the points that make triangles of less than 0.1 m2."""
    kept, changed = [tuple(p[:2]) for p in points], len(points) > 10
    while changed:
        changed, out, k = False, [kept[0]], 0
        while k + 2 < len(kept):
            (ax, ay), (bx, by), (cx, cy) = kept[k : k + 3]
            if 0.5 * abs((ax - cx) * (by - ay) - (ax - bx) * (cy - ay)) < 0.1:
                changed, k = True, k + 2
            else:
                k += 1
            out.append(kept[k])
        kept = out + kept[k + 1 :]
    return kept


class Roads:
    """Segments of lanes (0), lines (1) and edges (2) in cells of 5 m."""

    def __init__(self, features):
        starts, ends, kinds = [], [], []
        for feature in features:
            kind = next((k for k, name in enumerate(("LANE", "ROAD_LINE", "ROAD_EDGE")) if feature["type"].startswith(name)), None)
            if kind is not None and len(feature["points"]) > 1:
                line = simplified(feature["points"])
                starts, ends, kinds = starts + line[:-1], ends + line[1:], kinds + [kind] * (len(line) - 1)
        self.a, self.b = np.array(starts).reshape(-1, 2), np.array(ends).reshape(-1, 2)
        self.kind, self.middle, along = np.array(kinds), 0.5 * (self.a + self.b), self.b - self.a
        self.half = 0.5 * np.hypot(*along.T)
        self.way = along / np.maximum(2.0 * self.half, 1e-9)[:, None]
        self.corner = np.concatenate([self.a, self.b]).min(axis=0) if starts else np.zeros(2)
        self.cell = np.floor((self.middle - self.corner) / CELL).astype(int)

    def near(self, position):
        offset = self.cell - np.floor((np.array(position) - self.corner) / CELL).astype(int)
        found = np.nonzero(np.abs(offset).max(axis=1, initial=0) <= VISION)[0]
        rank = ORDER[offset[found, 0] + VISION, offset[found, 1] + VISION]
        return found[np.argsort(rank, kind="stable")][:ROADS]


class Network:
    def __init__(self, path):
        left = np.fromfile(path, dtype=np.float32)
        if left.size != 595_925:
            sys.exit(f"{path} has {left.size} numbers; expected the 595925 of PufferDrive's policy")

        def take(*shape):
            nonlocal left
            part, left = left[: math.prod(shape)], left[math.prod(shape) :]
            return part.reshape(shape)

        def encoder(size):
            return take(64, size), take(64), take(64), take(64), take(64, 64), take(64)

        self.ego, self.road, self.car = encoder(7), encoder(13), encoder(7)
        self.shared, self.actor, _ = (take(256, 192), take(256)), (take(20, 256), take(20)), (take(1, 256), take(1))
        self.lstm = take(1024, 256), take(1024, 256), take(1024), take(1024)
        self.reset()

    def reset(self):
        self.h, self.c = np.zeros(256, np.float32), np.zeros(256, np.float32)

    def encoded(self, weights, rows):
        w, b, scale, shift, second, bias = weights
        x = rows @ w.T + b
        x = (x - x.mean(axis=1, keepdims=True)) / np.sqrt(x.var(axis=1, keepdims=True) + 1e-5) * scale + shift
        return (x @ second.T + bias).max(axis=0)

    def action(self, ego, cars, roads):
        x = np.concatenate([self.encoded(self.ego, ego), self.encoded(self.road, roads), self.encoded(self.car, cars)])
        x = 0.5 * x * (1.0 + np.tanh(0.79788456 * (x + 0.044715 * x**3)))
        x = np.maximum(self.shared[0] @ x + self.shared[1], 0.0)
        gates = self.lstm[0] @ x + self.lstm[2] + self.lstm[1] @ self.h + self.lstm[3]
        i, f, g, o = np.split(gates, 4)
        self.c = self.c / (1.0 + np.exp(-f)) + np.tanh(g) / (1.0 + np.exp(-i))
        self.h = np.tanh(self.c) / (1.0 + np.exp(-o))
        logits = self.actor[0] @ self.h + self.actor[1]
        return ACCELERATIONS[np.argmax(logits[:7])], STEERINGS[np.argmax(logits[7:])]


def touches(size, a, b):
    """Whether segments in a car's frame meet its box."""
    low, high = np.zeros(len(a)), np.ones(len(a))
    for axis in (0, 1):
        way = np.where(np.abs(b[:, axis] - a[:, axis]) < 1e-9, 1e-9, b[:, axis] - a[:, axis])
        first, last = (-0.5 * size[axis] - a[:, axis]) / way, (0.5 * size[axis] - a[:, axis]) / way
        low, high = np.maximum(low, np.minimum(first, last)), np.minimum(high, np.maximum(first, last))
    return bool((low <= high).any())


class PufferDrive:
    wants_goal = True

    def __init__(self, weights):
        self.network, self.maps = Network(weights), {}

    def reset(self, scene, seed):
        if scene.id not in self.maps:
            self.maps = {scene.id: Roads(scene.map)}  # drives of a scene come one after another
        self.scene, self.car, self.there, self.arrived = scene, scene.car, None, False
        self.begin(self.maps[scene.id], scene.route.point(scene.goal), scene.car.length, scene.car.width)

    def begin(self, roads, goal, length, width):
        self.roads, self.goal, self.size = roads, goal, (SHRUNK * length, SHRUNK * width)
        self.network.reset()

    def seen(self, state, cars):
        """What the policy observes: rows of the ego, of cars and of segments of roads."""
        x, y, heading, speed = state
        turn = np.array([[math.cos(heading), -math.sin(heading)], [math.sin(heading), math.cos(heading)]])
        rows, contact = np.zeros((CARS, 7), np.float32), False
        cars = [car for car in cars if math.hypot(car.x - x, car.y - y) <= 50.0][:CARS]
        for row, car in zip(rows, cars):
            length, width, angle = SHRUNK * car.length, SHRUNK * car.width, car.heading - heading
            place = (np.array([car.x, car.y]) - (x, y)) @ turn
            row[:] = [*(0.02 * place), width / 15.0, length / 30.0, math.cos(angle), math.sin(angle), car.speed / 100.0]
            ahead, aside = np.array([math.cos(angle), math.sin(angle)]) * length / 2, np.array([-math.sin(angle), math.cos(angle)]) * width / 2
            corners = place + np.array([ahead + aside, ahead - aside, -ahead - aside, aside - ahead])
            contact = contact or touches(self.size, corners, np.roll(corners, 1, axis=0))
        near = self.roads.near((x, y))
        a, b, edge = (self.roads.a[near] - (x, y)) @ turn, (self.roads.b[near] - (x, y)) @ turn, self.roads.kind[near] == 2
        contact = contact or touches(self.size, a[edge], b[edge])
        roads = np.zeros((ROADS, 13), np.float32)
        roads[:, 6] = 1.0  # the zeros of empty places are lanes
        roads[: len(near), 0:2], roads[: len(near), 2] = 0.01 * (a + b), self.roads.half[near] / 100.0
        roads[: len(near), 3], roads[: len(near), 4:6] = 0.001, self.roads.way[near] @ turn
        roads[: len(near), 6:9] = np.eye(3)[self.roads.kind[near]]
        length, width = self.size
        ego = [*(0.005 * ((np.array(self.goal) - (x, y)) @ turn)), 0.01 * abs(speed), width / 15.0, length / 30.0, float(contact), 0.0]
        return np.array([ego], np.float32), rows, roads

    def moved(self, state, acceleration, steering):
        """The vehicle of its simulator, a step later."""
        x, y, heading, speed = state
        speed, slip = abs(speed) + 0.5 * acceleration * STEP, math.tanh(0.5 * math.tan(steering))
        x, y = x + STEP * speed * math.cos(heading + slip), y + STEP * speed * math.sin(heading + slip)
        return x, y, heading + STEP * speed * math.cos(slip) * math.tan(steering) / self.size[0], speed

    def act(self, obs):
        ego, cars = obs.ego, [agent for agent in obs.agents if agent.type == "vehicle"]
        self.there = self.there or {car.id for car in cars}  # those of the first frame
        state = (ego.x, ego.y, ego.heading, math.hypot(ego.vx, ego.vy))
        self.arrived = self.arrived or math.dist(state[:2], self.goal) < REACHED
        acceleration, steering = self.network.action(*self.seen(state, [car for car in cars if car.id in self.there]))
        if self.arrived:
            steer = obs.steer_to(self.scene.route, 2.0 + 0.3 * ego.speed)
            return {"acceleration": -BRAKE, "steering_angle": steer * self.car.max_steering_angle}
        bend = math.cos(math.tanh(0.5 * math.tan(steering))) * math.tan(steering) / self.size[0]
        rear, base = self.car.rear_axle, self.car.front_axle + self.car.rear_axle
        angle = math.atan(bend * base / math.sqrt(max(1.0 - (bend * rear) ** 2, 0.01)))
        return {"acceleration": max(0.5 * acceleration, -ego.speed / STEP - 0.5), "steering_angle": angle}


if __name__ == "__main__":
    serve(PufferDrive(sys.argv[1] if len(sys.argv) == 2 else sys.exit("usage: pufferdrive.py WEIGHTS")))

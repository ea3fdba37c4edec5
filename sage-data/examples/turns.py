"""Turns of written plans against the rule `drivable`, computed anew with numpy.

    sage generate SCENES --lambda 1 --format rows --no-pages --out rows
    python3 sage-data/examples/turns.py SCENES rows

SCENES holds pickles. Compares the violations `turning_circle` and `lateral_acceleration` of every candidate of every row.
"""

import json
import pathlib
import pickle
import sys

import numpy as np

TURN, LATERAL = 0.25, 6.0


def box_headings(points, heading, reverses):
    """Headings of the boxes (rad) after *now*: those of the motion from 0.5 m/s on, held below."""
    found, first = [], None
    for k, way in enumerate(np.diff(points, axis=0) @ [1, 1j]):
        if abs(way) / 0.1 >= 0.5:
            reverses &= np.cos(np.angle(way) - heading) < 0
            heading = np.angle(-way if reverses else way)
            first = k if first is None else first
        found.append(heading)
    return [found[first or 0]] * (first or 0) + found[first or 0 :]


def directions(points, heading, reverses):
    """Places (m along the path) and directions (rad, without jumps) from the heading at *now* on."""
    boxes = box_headings(points, heading, reverses)
    places, turned = [0.0], [heading]
    at, along = points[0], 0.0
    rest = []

    def add(step):
        way = complex(*(points[step] - at))
        direction = np.angle(way * np.exp(-1j * turned[-1]))
        # Backwards: against the way that it went, and against the box.
        if abs(direction) > np.pi / 2 and np.cos(np.angle(way) - boxes[step - 1]) < 0:
            direction = np.angle(-way * np.exp(-1j * turned[-1]))
        places.append(along + abs(way) / 2)
        turned.append(turned[-1] + direction)
        return abs(way)

    for step in range(1, len(points)):
        if np.hypot(*(points[step] - at)) >= 0.5:
            along += add(step)
            at, rest = points[step], []
        else:
            rest.append(step)
    far = [np.hypot(*(points[step] - at)) for step in rest]
    if far and max(far) >= 0.4:
        add(rest[int(np.argmax(far))])
    return np.array(places), np.array(turned)


def turn_per_metre(points, heading, reverses):
    places, turned = directions(points, heading, reverses)
    apart = places[None, :] - places[:, None]
    near = (apart > 0) & (apart <= 2.0)
    return np.max(np.abs(turned[None, :] - turned[:, None]) * near, initial=0.0) / 2.0


def lateral_acceleration(points):
    before, after = points[5:-5] - points[:-10], points[10:] - points[5:-5]
    b, a = before @ [1, 1j], after @ [1, 1j]
    counts = (abs(b) >= 0.5) & (abs(a) >= 0.5) & ((before * after).sum(1) >= 0)
    turn = np.abs(np.angle(a * np.conj(b)))
    return np.max((abs(a) + abs(b)) / 2 / 0.5 * turn / 0.5 * counts, initial=0.0)


def main(scenes, rows):
    count = tight = fast = 0
    for row in sorted(pathlib.Path(rows).glob("*-lambda*.json")):
        row = json.loads(row.read_text())
        with open(next(pathlib.Path(scenes).rglob(f"{row['scene']}.pkl")), "rb") as file:
            state = pickle.load(file)["tracks"][row["adversary"]]["state"]
        now = np.asarray(state["position"][10], float)[:2]
        heading = float(np.ravel(state["heading"])[10])
        velocity = (now - np.asarray(state["position"][9], float)[:2]) / 0.1
        limit = TURN * min(1.0, 6.0 / float(np.ravel(state["length"])[10]))
        for candidate in row["candidates"]:
            plan = np.array(candidate["trajectory"], float)
            points = np.vstack([now, plan])
            backwards = np.hypot(*velocity) >= 0.5 and velocity @ [np.cos(heading), np.sin(heading)] < 0
            found = [turn_per_metre(points, heading, backwards) > limit, lateral_acceleration(points) > LATERAL]
            rules = {violation["rule"] for violation in candidate["scores"]["violations_drivable"]}
            said = ["turning_circle" in rules, "lateral_acceleration" in rules]
            if found != said:
                sys.exit(f"{row['scene']}: {found} here, {said} in the row; {turn_per_metre(points, heading, backwards)}")
            count, tight, fast = count + 1, tight + found[0], fast + found[1]
    print(f"{count} plans agree: {tight} turn too tightly, {fast} too fast")


if __name__ == "__main__":
    main(*sys.argv[1:])

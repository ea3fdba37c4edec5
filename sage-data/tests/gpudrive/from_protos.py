"""Scenes of a TFRecord file of Scenario protos as JSON of GPUDrive: an independent reading of the rules of docs/formats.md.

Usage: from_protos.py SHARD ADVERSARIES, where ADVERSARIES is a JSON list with the id of the adversary of each record, or
null. Prints a JSON list. Needs numpy alone.
"""

import json
import math
import struct
import sys

import numpy as np

ABSENT = -10000.0
KINDS = {1: "vehicle", 2: "pedestrian", 3: "cyclist", 4: "other"}
# Field of MapFeature: type, first map_element_id, number of types, field of the points.
ROADS = {
    3: ("lane", 0, 4, 8),
    4: ("road_line", 5, 9, 2),
    5: ("road_edge", 14, 3, 2),
    7: ("stop_sign", 17, 0, 2),
    8: ("crosswalk", 18, 0, 1),
    9: ("speed_bump", 19, 0, 1),
    10: ("driveway", 20, 0, 1),
}
STATES = [
    "unknown", "arrow_stop", "arrow_caution", "arrow_go", "stop", "caution", "go", "flashing_stop", "flashing_caution",
]


def varint(data, at):
    value = shift = 0
    while True:
        byte = data[at]
        value |= (byte & 127) << shift
        at, shift = at + 1, shift + 7
        if byte < 128:
            return (value - (1 << 64) if value >= 1 << 63 else value), at


def packed(data):
    at = 0
    while at < len(data):
        value, at = varint(data, at)
        yield value


def fields(data):
    """Number and value of each field: an int, a double, a float or bytes."""
    at = groups = 0
    while at < len(data):
        key, at = varint(data, at)
        kind = key & 7
        if kind == 0:
            value, at = varint(data, at)
        elif kind == 1:
            value, at = struct.unpack_from("<d", data, at)[0], at + 8
        elif kind == 5:
            value, at = struct.unpack_from("<f", data, at)[0], at + 4
        elif kind == 2:
            length, at = varint(data, at)
            value, at = data[at : at + length], at + length
        else:
            groups += 1 if kind == 3 else -1
            continue
        # The schema has no groups.
        if not groups:
            yield key >> 3, value


def single(value):
    """As ScenarioNet's converter keeps numbers: 32 bits."""
    return float(np.float32(value))


def point(data):
    found = {1: 0.0, 2: 0.0, 3: 0.0, **dict(fields(data))}
    return {axis: single(found[number]) for number, axis in ((1, "x"), (2, "y"), (3, "z"))}


def track(data, frames):
    identity, kind, states = 0, 0, []
    for number, value in fields(data):
        if number == 1:
            identity = value
        elif number == 2:
            kind = value
        elif number == 3:
            states.append({k: 0 for k in range(2, 12)} | dict(fields(value)))
    # As many as there are times: more are dropped, and missing ones are absent.
    states = states[:frames] + [{k: 0 for k in range(2, 12)}] * (frames - len(states))
    valid = [bool(state[11]) for state in states]
    if kind not in KINDS or not any(valid):
        return None
    last = [state for state in states if state[11]][-1]
    place = lambda state: {"x": single(state[2]), "y": single(state[3]), "z": single(state[4])}
    nowhere = {"x": ABSENT, "y": ABSENT, "z": ABSENT}
    turned = lambda angle: (angle + math.pi) % (2 * math.pi) - math.pi
    return {
        "position": [place(s) if s[11] else nowhere for s in states],
        "width": last[6],
        "length": last[5],
        "height": last[7],
        "heading": [turned(s[8]) if s[11] else ABSENT for s in states],
        "velocity": [{"x": s[9], "y": s[10]} if s[11] else {"x": ABSENT, "y": ABSENT} for s in states],
        "valid": valid,
        "goalPosition": place(last),
        "type": KINDS[kind],
        "id": identity,
        "mark_as_expert": False,
    }


def road(data):
    identity, found = 0, None
    for number, value in fields(data):
        if number == 1:
            identity = value
        elif number in ROADS and isinstance(value, bytes):
            # Parts of one message are merged.
            found = (number, found[1] + value if found and found[0] == number else value)
    if found is None:
        return None
    number, data = found
    name, first, count, points = ROADS[number]
    kind = dict(fields(data)).get(2 if number == 3 else 1, 0) if count else 0
    if number == 7:
        geometry = [point(dict(fields(data))[2])]
    else:
        geometry = [point(value) for field, value in fields(data) if field == points]
    return {"geometry": geometry, "type": name, "map_element_id": first + kind, "id": identity}


def unknown_boundaries(lane):
    """Features that bound a lane and are no lines: edges, even if their own type is not known."""
    for number, value in fields(lane):
        segments = [value] if number in (13, 14) else []
        if number in (11, 12):
            segments = [inner for field, inner in fields(value) if field == 6]
        for segment in segments:
            found = {3: 0, 4: 0} | dict(fields(segment))
            if found[4] == 0:
                yield found[3]


def scene(data, adversary):
    edges = set()
    tracks, roads, steps, interest, predictions = [], {}, [], [], []
    identity, ego, frames = "", 0, 0
    for number, value in fields(data):
        if number == 1:
            frames += len(value) // 8 if isinstance(value, bytes) else 1
        if number == 2:
            tracks.append(value)
        elif number == 4:
            interest += packed(value) if isinstance(value, bytes) else [value]
        elif number == 5:
            identity = value.decode()
        elif number == 6:
            ego = value
        elif number == 7:
            steps.append(value)
        elif number == 8:
            edges |= {edge for number, lane in fields(value) if number == 3 and isinstance(lane, bytes) for edge in unknown_boundaries(lane)}
            if found := road(value):
                roads[found["id"]] = found
        elif number == 11:
            predictions.append({1: 0, 2: 0} | dict(fields(value)))
    ids = [dict(fields(one)).get(1, 0) for one in tracks]
    kept = {i: made for i, one in enumerate(tracks) if (made := track(one, frames))}
    first = [ego] + [i for i in kept if adversary is not None and ids[i] == adversary and i != ego]
    order = first + [i for i in kept if i not in first]
    order.sort(key=lambda i: kept[i]["type"] == "other")
    lights = {}
    for frame, step in enumerate(steps[:frames]):
        states = [{1: 0, 2: 0, 3: b""} | dict(fields(value)) for _, value in fields(step)]
        # Of two states of a lane the later holds.
        for lane in {state[1]: state for state in states}.values():
            light = lights.setdefault(str(lane[1]), {"state": [], "time_index": [], "stop": None})
            light["state"].append(STATES[lane[2]])
            light["time_index"].append(frame)
            light["stop"] = point(lane[3])
    # A scene has one stop point for each light: the last.
    for light in lights.values():
        stop = light.pop("stop")
        light.update({axis: [stop[axis]] * len(light["state"]) for axis in "xyz"})
    # MetaDrive has one word for lines and edges of unknown type.
    for one in roads.values():
        if one["map_element_id"] == 14 and one["id"] not in edges:
            one.update(type="road_line", map_element_id=5)
    place = {i: k for k, i in enumerate(order)}
    present = {ids[i] for i in order}
    return {
        "name": f"{identity}.json",
        "scenario_id": identity,
        "objects": [kept[i] for i in order],
        "roads": list(roads.values()),
        "tl_states": lights,
        "metadata": {
            "sdc_track_index": 0,
            "objects_of_interest": [i for i in interest if i in present],
            "tracks_to_predict": [
                {"track_index": place[p[1]], "difficulty": p[2]} for p in predictions if p[1] in place
            ],
        },
    }


def records(path):
    data = open(path, "rb").read()
    at = 0
    while at < len(data):
        length = struct.unpack_from("<Q", data, at)[0]
        yield data[at + 12 : at + 12 + length]
        at += 16 + length


if __name__ == "__main__":
    adversaries = json.loads(sys.argv[2])
    scenes = [scene(data, other) for data, other in zip(records(sys.argv[1]), adversaries, strict=True)]
    json.dump(scenes, sys.stdout)

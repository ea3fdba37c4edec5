#!/usr/bin/env python3
"""Generates the small scene files of the tests and of `examples/`. It needs numpy and runs in any folder:

    python3 sage-data/tests/data/make_pickles.py

All data is synthetic; none is recorded. The files are committed, so the tests need no Python. A second run
writes the same bytes (numpy 2).
"""
import collections
import copy
import io
import json
import math
import pickle
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
EXAMPLES = HERE.parents[2] / "examples"


class Spelled(pickle._Pickler):
    """A pickler that writes numpy's functions with the old or the new module names."""

    def __init__(self, file, protocol, core):
        super().__init__(file, protocol)
        self.core = core

    def save_global(self, obj, name=None):
        module = getattr(obj, "__module__", None) or pickle.whichmodule(obj, name or obj.__qualname__)
        if module.startswith(("numpy.core", "numpy._core")):
            module = self.core + module[module.index(".", len("numpy.")):]
            name = name or obj.__qualname__
            if self.proto >= 4:
                self.save(module)
                self.save(name)
                self.write(pickle.STACK_GLOBAL)
            else:
                self.write(pickle.GLOBAL + f"{module}\n{name}\n".encode())
            self.memoize(obj)
        else:
            super().save_global(obj, name)

    dispatch = dict(pickle._Pickler.dispatch)
    dispatch[type(len)] = save_global


def dumps(value, protocol=4, core="numpy.core"):
    out = io.BytesIO()
    Spelled(out, protocol, core).dump(value)
    return out.getvalue()


def track(kind, start, heading, speed, size, frames, dtype=np.float32, valid=None):
    """A track with constant speed and heading."""
    t = 0.1 * np.arange(frames)
    direction = np.array([math.cos(heading), math.sin(heading)])
    position = np.zeros((frames, 3), dtype)
    position[:, :2] = np.array(start) + np.outer(t * speed, direction)
    position[:, 2] = 0.5 * size[2]
    state = {
        "position": position,
        "length": np.full(frames, size[0], dtype),
        "width": np.full(frames, size[1], dtype),
        "height": np.full(frames, size[2], dtype),
        "heading": np.full(frames, heading, dtype),
        "velocity": np.tile((speed * direction).astype(dtype), (frames, 1)),
        "valid": np.ones(frames, bool) if valid is None else valid,
    }
    for column in state.values():
        column[~state["valid"]] = 0
    return {"type": kind, "state": state, "metadata": {"type": kind, "track_length": frames}}


def line(start, end, step=1.0):
    start, end = np.array(start, float), np.array(end, float)
    n = max(2, int(np.ceil(np.linalg.norm(end - start) / step)) + 1)
    points = np.zeros((n, 3), np.float32)
    points[:, :2] = start + np.linspace(0, 1, n)[:, None] * (end - start)
    return points


def lane(start, end, **links):
    points = line(start, end)
    return {
        "type": "LANE_SURFACE_STREET", "polyline": points, "speed_limit_mph": 30.0, "speed_limit_kmh": 48.28,
        "interpolating": False, "entry_lanes": [], "exit_lanes": [], "left_boundaries": [], "right_boundaries": [],
        "left_neighbor": [], "right_neighbor": [], "width": np.full((len(points), 2), 1.75, np.float32), **links,
    }


def scene(name, frames, tracks, features, lights, ego, interest):
    return {
        "id": name, "version": "invented", "length": frames, "tracks": tracks, "dynamic_map_states": lights,
        "map_features": features,
        "metadata": {
            "sdc_id": ego, "scenario_id": name, "objects_of_interest": interest, "current_time_index": 10,
            "ts": (0.1 * np.arange(frames)).astype(np.float32), "coordinate": "waymo", "dataset": "invented",
            "number_summary": {"object_types": {"VEHICLE", "PEDESTRIAN"}}, "tracks_to_predict": {},
        },
    }


def crossing(frames=91):
    """Two roads that cross. The ego drives east, and the adversary drives north and passes well ahead of it."""
    late = np.ones(frames, bool)
    late[: frames // 3] = False
    tracks = {
        "ego": track("VEHICLE", (-40, -1.75), 0.0, 10.0, (4.6, 1.9, 1.5), frames),
        "crosser": track("VEHICLE", (1.75, -22), math.pi / 2, 8.0, (4.4, 1.8, 1.5), frames),
        "leader": track("VEHICLE", (-12, -1.75), 0.0, 10.0, (4.5, 1.8, 1.5), frames),
        "parked": track("VEHICLE", (-5.0, -15), math.pi / 2, 0.0, (4.3, 1.7, 1.6), frames),
        "walker": track("PEDESTRIAN", (20, 12), math.pi, 1.2, (0.7, 0.7, 1.7), frames, valid=late),
    }
    features = {
        "east": lane((-60, -1.75), (60, -1.75), left_neighbor=[
            {"feature_id": "west", "self_start_index": "0", "self_end_index": "120", "neighbor_start_index": "0",
             "neighbor_end_index": "120", "boundaries": []}]),
        "west": lane((60, 1.75), (-60, 1.75)),
        "north": lane((1.75, -60), (1.75, 60), exit_lanes=["beyond the map"], left_boundaries=[
            {"lane_start_index": "0", "lane_end_index": "50", "boundary_type": "ROAD_LINE_SOLID_DOUBLE_YELLOW",
             "boundary_feature_id": "yellow"}]),
        "south": lane((-1.75, 60), (-1.75, -60)),
        "stub": {**lane((0, 0), (1, 0)), "polyline": np.zeros((1, 3), np.float32), "width": np.ones((1, 2), np.float32)},
        "yellow": {"type": "ROAD_LINE_SOLID_DOUBLE_YELLOW", "polyline": line((0, -60), (0, -8))},
        "crosswalk": {"type": "CROSSWALK", "polygon": np.array(
            [[4, 4, 0], [8, 4, 0], [8, -4, 0], [4, -4, 0]], np.float32)},
        "stop": {"type": "STOP_SIGN", "lane": ["south"], "position": np.array([-3.0, 6.0, 0.0], np.float32)},
    }
    # Road edges around the four corners, each with the road on its left.
    for k in range(4):
        turn = np.array([[0, -1], [1, 0]])
        a, corner, b = (np.linalg.matrix_power(turn, k) @ np.array(p) for p in [(60.0, 8.0), (8.0, 8.0), (8.0, 60.0)])
        # From the end of one road to the corner, and from the corner to the end of the other road.
        points = np.concatenate([line(b, corner), line(corner, a)[1:]])
        features[f"edge{k}"] = {"type": "ROAD_EDGE_BOUNDARY", "polyline": points}
    lights = {"north": {
        "type": "TRAFFIC_LIGHT", "lane": "north", "stop_point": np.array([1.75, -8.0, 0.0], np.float32),
        "state": {"object_state": ["LANE_STATE_GO"] * (frames - 1) + [None]}, "metadata": {"type": "TRAFFIC_LIGHT"},
    }}
    return scene("crossing", frames, tracks, features, lights, "ego", ["ego", "crosser"])


def attacks():
    """Candidates for the adversary of `crossing`: log, late arrival, stop, turn over the kerb, braking ego."""
    t = 0.1 * np.arange(1, 81)
    x0, y0 = 1.75, -14.0
    straight = lambda s: [[x0, round(float(y0 + d), 4)] for d in s]
    # `wait` brakes to a stop in front of the ego's lane; `meet` brakes to 3.6 m/s.
    v = np.clip(8.0 - 3.0 * t, 0, None)
    wait = np.cumsum(v) * 0.1
    meet = np.cumsum(np.clip(8.0 - 5.0 * t, 3.6, None)) * 0.1
    angle = np.clip(0.5 * (t - 1.0), 0, math.pi / 2)
    turn = np.cumsum(np.stack([np.sin(angle), np.cos(angle)], 1) * 0.8, 0)
    return [
        {"name": "as logged", "trajectory": straight(8.0 * t)},
        {"name": "slow to meet", "trajectory": straight(meet)},
        {"name": "brake and stand", "trajectory": straight(wait)},
        {"name": "right over the kerb", "trajectory": [[round(float(x0 + x), 4), round(float(y0 + y), 4)] for x, y in turn]},
        {"name": "the ego brakes instead", "trajectory": straight(meet),
         "ego": [[round(float(-30 + s), 4), -1.75, 0.0] for s in np.cumsum(np.clip(10 - 4 * t, 0, None)) * 0.1]},
    ]


def small():
    """A scene of 14 frames with the dtypes, lists and containers that other writers use."""
    frames = 14
    wide = track("VEHICLE", (0, 0), 0.0, 5.0, (4.5, 1.9, 1.5), frames, np.float64)
    for key in ("length", "width", "height"):
        wide["state"][key] = wide["state"][key].reshape(frames, 1)
    wide["state"]["valid"] = wide["state"]["valid"].astype(np.float64)
    order = track("VEHICLE", (20, 3), math.pi, 6.0, (4.8, 2.0, 1.6), frames, np.float64)
    order["state"]["position"] = np.asfortranarray(order["state"]["position"])
    order["state"]["heading"] = order["state"]["heading"].astype(">f8")
    gap = np.ones(frames, bool)
    gap[[2, 11]] = False
    listed = track("CYCLIST", (5, -4), 0.3, 3.0, (1.8, 0.6, 1.7), frames, valid=gap)
    listed["state"]["velocity"] = [tuple(map(float, row)) for row in listed["state"]["velocity"]]
    cone = track("TRAFFIC_CONE", (9, 4), 0.0, 0.0, (0.4, 0.4, 0.8), frames)
    features = {
        "a": {**lane((-10, 0), (40, 0)), "exit_lanes": [17]},
        17: {"type": "LANE_SURFACE_STREET", "polyline": [(40.0, 0.0, 0.0), (45.0, 1.0, 0.0), (50.0, 3.0, 0.0)]},
        "edge": {"type": "ROAD_EDGE_BOUNDARY", "polyline": line((-10, -6), (60, -6)).astype(np.float64)},
        "median": {"type": "ROAD_EDGE_MEDIAN", "polyline": np.array([[0, 9, 1], [30, 9, 1]], np.int16)},
    }
    made = scene("small", frames, {"ego": wide, "1": order, "2": listed, "3": cone}, features, {}, "ego", ["1", "ego"])
    counter = collections.defaultdict(int)
    counter.update({"VEHICLE": 2, "CYCLIST": 1})
    made["metadata"].update({
        "counter": counter, "scalar": np.float32(1.5), "whole": np.int64(-7), "huge": 2**80, "negative": -(2**40),
        "raw": b"\x00\xff\x80abc", "nested": ((), (1,), (1, 2), (1, 2, 3), (1, 2, 3, 4)),
        "text": "päth \U0001f697", "long": "x" * 300, "truth": [True, False, None], "type": np.dtype("f4"),
        "shared": [counter, counter], "small": [0, 255, 256, 65535, 65536, -1], "zero": np.float64(-0.0),
        "empty": [{}, [], (), set(), np.zeros((0, 3), np.float32)],
    })
    return made


def broken():
    """Scenes with one error each, by file name."""
    out = {}

    def variant(name, change):
        made = small()
        change(made)
        out[name] = made

    def put(*path_and_value):
        *path, key, value = path_and_value

        def change(made):
            for step in path:
                made = made[step]
            if isinstance(made, np.ndarray):
                made.__setitem__(key, value)
            else:
                made[key] = value
        return change

    def drop(*path):
        def change(made):
            for step in path[:-1]:
                made = made[step]
            del made[path[-1]]
        return change

    ego = ("tracks", "ego", "state")
    variant("nan_position", put(*ego, "position", (3, 1), np.nan))
    variant("infinite_heading", put("tracks", "1", "state", "heading", 5, np.inf))
    variant("nan_polyline", put("map_features", "edge", "polyline", (2, 0), np.nan))
    variant("empty_polyline", put("map_features", "edge", "polyline", np.zeros((0, 3), np.float32)))
    variant("empty_column", put(*ego, "heading", np.zeros(0)))
    variant("ragged_rows", put("map_features", "edge", "polyline", [(0.0, 0.0, 0.0), (1.0,)]))
    variant("short_column", put(*ego, "velocity", np.zeros((13, 2))))
    variant("wide_column", put(*ego, "heading", np.zeros((14, 4))))
    variant("text_in_numbers", put("tracks", "2", "state", "velocity", [("a", "b")] * 14))
    variant("no_ego", drop("metadata", "sdc_id"))
    variant("unknown_ego", put("metadata", "sdc_id", "nobody"))
    variant("ego_not_seen", put(*ego, "valid", 10, 0.0))
    variant("no_length", drop("length"))
    variant("too_short", put("length", 10))
    variant("huge_length", put("length", 2**62))
    variant("zero_width", put("tracks", "1", "state", "width", 4, 0.0))
    variant("no_tracks", drop("tracks"))
    variant("tracks_not_a_dict", put("tracks", [1, 2]))
    variant("not_a_scene", lambda made: (made.clear(), made.update(a=1)))
    variant("no_points", lambda made: made["map_features"]["edge"].pop("polyline"))
    variant("short_light", lambda made: made["dynamic_map_states"].update(
        a={"type": "TRAFFIC_LIGHT", "lane": "a", "state": {"object_state": ["LANE_STATE_GO"]}}))
    return out


def main():
    EXAMPLES.mkdir(exist_ok=True)
    (EXAMPLES / "crossing.pkl").write_bytes(dumps(crossing()))
    rows = ",\n".join(json.dumps(row) for row in attacks())
    (EXAMPLES / "crossing.json").write_text(f"[\n{rows}\n]\n")
    value = small()
    for protocol in range(2, 6):
        for core in ("numpy.core", "numpy._core"):
            (HERE / f"small_p{protocol}_{core.split('.')[1]}.pkl").write_bytes(dumps(value, protocol, core))
    five = copy.deepcopy(value)
    # Types that only protocol 5, or 4 and 5, can store without a global.
    five["metadata"].update(bytearray=bytearray(b"abc"), frozen=frozenset([1]))
    (HERE / "newest_p5.pkl").write_bytes(dumps(five, 5))
    bad = HERE / "broken"
    bad.mkdir(exist_ok=True)
    for name, made in broken().items():
        (bad / f"{name}.pkl").write_bytes(dumps(made))
    # A ScenarioNet folder with a summary and a mapping.
    folder = HERE / "scenarionet"
    (folder / "part").mkdir(parents=True, exist_ok=True)
    for name in ("sd_b.pkl", "sd_a.pkl"):
        (folder / "part" / name).write_bytes(dumps(value))
    (folder / "unlisted.pkl").write_bytes(b"not a scene")
    (folder / "dataset_summary.pkl").write_bytes(dumps({"sd_b.pkl": {"id": "b"}, "sd_a.pkl": {"id": "a"}}))
    (folder / "dataset_mapping.pkl").write_bytes(dumps({"sd_b.pkl": "part", "sd_a.pkl": "part"}))


main()

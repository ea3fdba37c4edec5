"""Compares what sage writes with Waymo's protos and with an independent converter.

    python compare.py MAKE_WOMD SHARD PICKLES WRITTEN

MAKE_WOMD is a folder with a module `make_womd` that has `records` (the records of a TFRecord file, checksums verified)
and `to_pickle` (a Scenario as the values of ScenarioNet's converter). SHARD is a shard, PICKLES the folder of its
scenes as sage converted them to pickles, WRITTEN the shard that sage wrote of its scenes. Exits with 1 at the first
difference. Needs numpy and waymo_open_dataset.protos.
"""
import pickle, sys
from pathlib import Path
import numpy as np


def differences(a, b, place=""):
    """Places where two values differ, also in the types of keys, values and arrays."""
    if type(a) is not type(b):
        yield f"{place}: {type(a).__name__} and {type(b).__name__}"
    elif isinstance(a, dict):
        if list(a) != list(b) or [type(k) for k in a] != [type(k) for k in b]:
            yield f"{place}: keys {list(a)[:12]} and {list(b)[:12]}"
        for key in a:
            if key in b:
                yield from differences(a[key], b[key], f"{place}/{key}")
    elif isinstance(a, list):
        if len(a) != len(b):
            yield f"{place}: {len(a)} and {len(b)} items"
        for k, (x, y) in enumerate(zip(a, b)):
            yield from differences(x, y, f"{place}/{k}")
    elif isinstance(a, np.ndarray):
        if a.dtype != b.dtype or a.shape != b.shape or a.tobytes() != b.tobytes():
            yield f"{place}: {a.dtype} {a.shape} and {b.dtype} {b.shape}, or other values"
    elif a != b:
        yield f"{place}: {a!r} and {b!r}"


def without_extras(found, expected):
    """The part of a converted file that `expected` describes, with its keys in the same order.

    Files hold more than the independent converter makes: types and metadata of each object, and summaries."""
    if isinstance(expected, dict) and isinstance(found, dict):
        return {key: without_extras(found[key], expected[key]) for key in expected if key in found}
    return found


def main():
    make_womd, shard, pickles, written = sys.argv[1:]
    sys.path.insert(0, make_womd)
    from make_womd import records, to_pickle
    from waymo_open_dataset.protos import scenario_pb2

    parse = lambda path: [scenario_pb2.Scenario.FromString(data) for data in records(Path(path).read_bytes())]
    sources, copies = parse(shard), parse(written)
    assert len(sources) == len(copies), (len(sources), len(copies))
    for source, copy in zip(sources, copies):
        expected = to_pickle(source)
        for difference in differences(to_pickle(copy), expected):
            sys.exit(f"{source.scenario_id}, written as a record: {difference}")
        [file] = Path(pickles).glob(f"sd_*_{source.scenario_id}.pkl")
        found = pickle.load(open(file, "rb"))
        for difference in differences(without_extras(found, expected), expected):
            sys.exit(f"{source.scenario_id}, as a pickle: {difference}")
        for group, kind in (("tracks", None), ("dynamic_map_states", "TRAFFIC_LIGHT")):
            for name, value in found[group].items():
                metadata = value["metadata"]
                want = {"track_length": found["length"], "type": kind or value["type"], "object_id": name, "dataset": "waymo"}
                assert metadata == want and value["type"] == want["type"], (group, name, metadata)
        assert len(found["metadata"]["object_summary"]) == len(found["tracks"])
    print(f"{len(sources)} scenes agree")


main()

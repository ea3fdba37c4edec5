#!/usr/bin/env python3
"""Replays attacks in MetaDrive and checks that solid contacts happen there too.

Attack recorded scenes, then replay the written data set:

    sage generate SCENES/val --weights waymo --lambda 1 --json --out DIR > attacks.jsonl
    python examples/replay_in_metadrive.py DIR attacks.jsonl

Needs MetaDrive 0.4 (`pip install metadrive-simulator==0.4.3`). `python -m metadrive.pull_asset` downloads its
assets, the models and textures of the pictures. The replay draws nothing, so `--without-assets` works too: it
turns off the download that MetaDrive otherwise starts.

The ego and all other road users follow the file (`ReplayEgoCarPolicy`, `ReplayTrafficParticipantPolicy`). Step n
of MetaDrive is frame n of the file, and a row's `collision_step` k is frame 10 + k. An attack touches at the first
step in which MetaDrive sets the ego's crash flag and the ego's body touches the adversary's. The adversary is the
track that drives along the row's `trajectory`; for most files it is also the object of interest that is not the ego.

MetaDrive's vehicles have the boxes of a few classes: every ego is 4.5 m by 1.9 m. With `--boxes logged` (default)
the vehicles have the sizes in the file, the boxes in which `sage` measures contacts. `--boxes class` shows what a
MetaDrive with default settings does: smaller boxes touch later, and grazing contacts do not happen.

Prints a table and, as the last line, a summary as JSON. "Solid" is a contact with an overlap of 0.5 m or more.

Exit code: 0 if at least 95 % of the solid attacks touch within two steps of `collision_step`; 1 if not; 2 if the
replay cannot run. MetaDrive files are pickles: only replay files that you trust.
"""
import argparse
import json
import logging
import pickle
import statistics
import sys
from pathlib import Path
from typing import NamedTuple, Optional

NOW = 10  # frame of the present: the trajectory of a row begins one frame later
SOLID = 0.5  # metres of overlap
TOLERANCE = 2  # steps
REQUIRED_SHARE = 0.95
SAME_PLACE = 0.05  # metres: files store 32-bit positions, and world coordinates reach 100 km


class Stop(Exception):
    """The replay cannot run; the text names the remedy."""


class Replay(NamedTuple):
    """One attack and what MetaDrive reports. Frames are `None` if there was no contact."""

    scene: str
    variant: str
    believable: Optional[bool]
    depth: Optional[float]  # largest overlap in metres
    frame: Optional[int]  # first contact by sage
    touched: Optional[int]  # first contact with the adversary in MetaDrive
    crashed: Optional[int]  # first contact with any road user in MetaDrive

    @property
    def solid(self):
        return self.depth is not None and self.depth >= SOLID

    @property
    def difference(self):
        return None if self.frame is None or self.touched is None else self.touched - self.frame


# --- counting ---


def share(part, whole):
    return round(part / whole, 4) if whole else None


def count(replays):
    """Counts of one group of attacks that touch according to sage."""
    differences = [replay.difference for replay in replays if replay.difference is not None]
    near = sum(abs(difference) <= TOLERANCE for difference in differences)
    return {
        "attacks": len(replays),
        "touch": len(differences),
        "touch_share": share(len(differences), len(replays)),
        "within_two_steps": near,
        "within_two_steps_share": share(near, len(replays)),
        "median_difference": float(statistics.median(differences)) if differences else None,
    }


def summarise(replays):
    """All counts, and whether enough solid attacks touch at the right step."""
    solid = [replay for replay in replays if replay.solid]
    grazing = [replay for replay in replays if replay.frame is not None and not replay.solid]
    missed = [replay for replay in replays if replay.frame is None]
    counts = count(solid)
    near = counts["within_two_steps"]
    return {
        "attacks": len(replays),
        "solid": counts,
        "solid_and_believable": count([replay for replay in solid if replay.believable]),
        "grazing": count(grazing),
        "without_contact": {
            "attacks": len(missed),
            "touch": sum(replay.touched is not None for replay in missed),
        },
        "passed": bool(solid) and near >= REQUIRED_SHARE * len(solid),
    }


def table(replays):
    def cell(value):
        if value is None:
            return "-"
        if isinstance(value, bool):
            return "yes" if value else "no"
        return f"{value:.2f}" if isinstance(value, float) else str(value)

    rows = [("scene", "variant", "believable", "overlap m", "frame", "in MetaDrive", "difference", "first crash")]
    for r in replays:
        difference = None if r.difference is None else f"{r.difference:+d}"
        values = (r.scene, r.variant, r.believable, r.depth, r.frame, r.touched, difference, r.crashed)
        rows.append(tuple(map(cell, values)))
    widths = [max(map(len, column)) for column in zip(*rows)]
    # Names are flush left, numbers flush right.
    return "\n".join(
        "  ".join(text.ljust(width) if k < 2 else text.rjust(width) for k, (text, width) in enumerate(zip(row, widths)))
        for row in rows
    )


# --- input ---


def read_rows(path):
    """The rows that `sage generate --json` printed."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise Stop(f"cannot read the rows in {path}: {error}") from error
    rows = []
    for number, line in enumerate(lines, 1):
        if not line.strip():
            continue
        try:
            row = json.loads(line)
            # A missing key shall stop the program here, not after an hour of replay.
            _ = contact(row), pickle_name(row), row["scene"], row["variant"], len(row["trajectory"])
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise Stop(
                f"{path}, line {number}: not a row of an attack ({error!r}); "
                "write the file with: sage generate … --json --out DIR > attacks.jsonl"
            ) from error
        rows.append(row)
    if not rows:
        raise Stop(f"{path} has no rows; write it with: sage generate … --json --out DIR > attacks.jsonl")
    return rows


def contact(row):
    """Believable or not, largest overlap, and frame of the first contact."""
    scores = row["scores"]
    step = scores["collision_step"]
    return scores["believable"], scores["rewards"]["contact-depth"], None if step is None else NOW + step


def pickle_name(row):
    """Name of the row's MetaDrive file in the data set; the row may name it with a folder."""
    names = [Path(file).name for file in row["files"] if file.endswith(".pkl")]
    if len(names) != 1:
        raise ValueError("no pickle among its files: was it written with --format native?")
    return names[0]


def adversary(tracks, ego, trajectory):
    """Identifier of the track, other than the ego, that drives along the trajectory."""

    def distance(track):
        positions = track["state"]["position"][NOW + 1 : NOW + 1 + len(trajectory), :2]
        if len(positions) < len(trajectory):
            return float("inf")
        return max(abs(a - b) for p, q in zip(positions.tolist(), trajectory) for a, b in zip(p, q))

    found = [name for name, track in tracks.items() if name != ego and distance(track) <= SAME_PLACE]
    if len(found) != 1:
        raise Stop(
            f"{len(found)} tracks drive along the trajectory of the row instead of one; "
            "rows and pickles must be of the same run of sage generate"
        )
    return found[0]


def adversary_in(path, row):
    with open(path, "rb") as file:
        scenario = pickle.load(file)
    try:
        return adversary(scenario["tracks"], str(scenario["metadata"]["sdc_id"]), row["trajectory"])
    except Stop as error:
        raise Stop(f"{path}: {error}") from error


# --- MetaDrive ---


def check_metadrive(without_assets):
    try:
        from metadrive.engine.asset_loader import AssetLoader
        from metadrive.engine.base_engine import BaseEngine
        from metadrive.version import VERSION
    except ImportError as error:
        raise Stop(f"no MetaDrive ({error}); install it with: pip install metadrive-simulator==0.4.3") from error
    if not VERSION.startswith("0.4."):
        # 0.3 clears the crash flags of a replayed ego before anyone can read them.
        raise Stop(f"this is MetaDrive {VERSION}, not 0.4; install it with: pip install metadrive-simulator==0.4.3")
    if without_assets:
        # The engine downloads missing assets when it starts, even if it never draws.
        BaseEngine.try_pull_asset = staticmethod(lambda: None)
        return
    try:
        missing = AssetLoader.should_update_asset()
    except (OSError, ValueError):  # no folder, or no version file in it
        missing = True
    if missing:
        raise Stop(
            "MetaDrive's assets are missing or outdated; download them with: python -m metadrive.pull_asset --update, "
            "or replay with --without-assets"
        )


def data_set(folder):
    """Path of each file of the data set. MetaDrive counts scenes in the order of this dict."""
    from metadrive.scenario.utils import read_dataset_summary

    if not (folder / "dataset_summary.pkl").is_file():
        raise Stop(f"{folder} has no dataset_summary.pkl; write the data set with: sage generate … --out {folder}")
    try:
        _, names, folders = read_dataset_summary(folder)
    except AssertionError as error:
        raise Stop(f"{folder} is incomplete ({error}); write it again with: sage generate … --force") from error
    return {name: folder / folders[name] / name for name in names}


def environment(folder, scenes, boxes):
    from metadrive.envs.scenario_env import ScenarioEnv
    from metadrive.obs.observation_base import DummyObservation
    from metadrive.policy.replay_policy import ReplayEgoCarPolicy

    return ScenarioEnv(
        {
            "data_directory": str(folder),
            "num_scenarios": scenes,
            "agent_policy": ReplayEgoCarPolicy,
            "reactive_traffic": False,
            "no_static_vehicles": False,
            "use_bounding_box": boxes == "logged",
            # Objects are called like their tracks, so that a contact names the track.
            "force_reuse_object_name": True,
            # Nobody looks at observations, and lights touch nobody.
            "agent_observation": DummyObservation,
            "use_render": False,
            "image_observation": False,
            "no_light": True,
            # A data set may have thousands of scenes.
            "store_map": False,
            "store_data": False,
            "log_level": logging.ERROR,
        }
    )


class Contacts:
    """Notes which objects touch the ego in a step. Begins after the first reset, which creates the physics."""

    def __init__(self, env):
        from metadrive.engine.core.collision_callback import collision_callback
        from panda3d.core import PythonCallbackObject

        self.env = env
        self.names = set()
        self.metadrives_own = collision_callback
        self.world = env.engine.physics_world.dynamic_world
        # The world has room for one callback, and MetaDrive's sets the crash flags: ours calls it.
        self.callback = PythonCallbackObject(self.added)
        self.world.setContactAddedCallback(self.callback)

    def added(self, contact):
        self.metadrives_own(contact)
        self.note(contact)

    def note(self, contact):
        nodes = (contact.getNode0(), contact.getNode1())
        tags = [node.getPythonTag(node.getName()) for node in nodes]
        names = {getattr(tag, "base_object_name", None) for tag in tags}  # the ground and lines have none
        ego = self.env.agent.name
        if ego in names:
            self.names |= names - {ego, None}

    def step(self):
        """Makes a step. Returns whether MetaDrive reports a crash of the ego, and the names of what touched it."""
        self.names.clear()
        self.env.step([0, 0])
        ego = self.env.agent
        # The callback sees the physics between two frames, this test sees the frame itself, as MetaDrive's own does.
        for contact in self.world.contactTest(ego.chassis.node(), True).getContacts():
            self.note(contact)
        return ego.crash_vehicle or ego.crash_human, self.names


def first_contacts(env, contacts, target):
    """First frames at which the ego touches the target, and at which it touches any road user."""
    crashed = None
    for frame in range(1, env.engine.data_manager.current_scenario_length):
        crash, names = contacts.step()
        if crash and crashed is None:
            crashed = frame
        if crash and target in names:
            return frame, crashed  # what follows cannot change the answer
    return None, crashed


def replay_all(folder, rows, boxes):
    paths = data_set(folder)
    seeds = {name: seed for seed, name in enumerate(paths)}
    unknown = [name for name in map(pickle_name, rows) if name not in seeds]
    if unknown:
        raise Stop(f"{folder} has no {unknown[0]}: rows and data set must be of the same run of sage generate")
    env, contacts = environment(folder, len(paths), boxes), None
    try:
        for done, row in enumerate(rows, 1):
            name = pickle_name(row)
            target = adversary_in(paths[name], row)
            env.reset(seed=seeds[name])
            contacts = contacts or Contacts(env)
            believable, depth, frame = contact(row)
            touched, crashed = first_contacts(env, contacts, target)
            yield Replay(row["scene"], row["variant"], believable, depth, frame, touched, crashed)
            if sys.stderr.isatty():
                print(f"\r{done} of {len(rows)} attacks", end="\n" if done == len(rows) else "", file=sys.stderr)
    finally:
        env.close()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", metavar="DIR", type=Path, help="data set that sage generate wrote")
    parser.add_argument("rows", metavar="ROWS", type=Path, help="what sage generate --json printed")
    parser.add_argument("--boxes", choices=["logged", "class"], default="logged", help="sizes of the vehicles")
    parser.add_argument("--without-assets", action="store_true", help="do not download or need MetaDrive's assets")
    options = parser.parse_args()
    try:
        rows = read_rows(options.rows)
        if not any((contact(row)[1] or 0) >= SOLID for row in rows):
            raise Stop(f"{options.rows} has no solid attack to check; attack more scenes, with --lambda 1")
        check_metadrive(options.without_assets)
        replays = list(replay_all(options.data, rows, options.boxes))
    except Stop as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    summary = {"boxes": options.boxes, **summarise(replays)}
    print(table(replays))
    print(json.dumps(summary))
    return 0 if summary["passed"] else 1


if __name__ == "__main__":
    sys.exit(main())

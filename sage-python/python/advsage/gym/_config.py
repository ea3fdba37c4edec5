"""The configuration of environments: MetaDrive's keys where they mean the same, and our own."""

from __future__ import annotations

import difflib
import math
import os
from collections.abc import Iterable, Mapping
from typing import Any

from .. import _advsage
from ..errors import MissingFile, OptionError, UnknownName

#: A configuration: a dictionary with some of the keys of `DEFAULTS`.
Config = Mapping[str, Any]

#: Every key with its default.
DEFAULTS: dict[str, Any] = {
    # Scenes. MetaDrive's keys, but that without a folder the scenes are procedural.
    "data_directory": None,  # a folder of scene files
    "scenes": None,  # or scenes and paths, or what `sage.load_folder` returns
    "start_scenario_index": 0,
    "num_scenarios": None,  # None: all from the first one
    "sequential_seed": False,  # one scene after another; False: drawn
    "worker_index": 0,  # worker k of n takes every n-th scene, with `sequential_seed`
    "num_workers": 1,
    "scenes_in_memory": 256,  # scenes of files that are kept
    # Rules.
    "preset": "training",  # "training", "default" (with parked cars) or "metadrive" (the oddities of 0.3.0.1)
    "horizon": "recording",  # a number of steps; None: no limit; "recording": its end, 90 steps. After it there is no traffic
    "truncate_as_terminate": False,
    "crash_vehicle_done": False,
    "no_static_vehicles": True,
    "reactive_traffic": False,
    # Rewards and costs of a step.
    "driving_reward": 1.0,  # a metre along the route
    "success_reward": 10.0,
    "out_of_road_penalty": 10.0,
    "crash_vehicle_penalty": 1.0,
    "crash_object_penalty": 1.0,
    "out_of_road_cost": 1.0,
    "crash_vehicle_cost": 1.0,
    "crash_object_cost": 1.0,
    # The adversary: None, a `Generator`, what `sage.search` found, or a dictionary with some of the keys of `ADVERSARY`.
    "adversary": None,
    # Threads of a vector environment.
    "threads": 1,
}

#: What the presets set otherwise.
PRESETS: dict[Any, dict[str, Any]] = {
    "training": {},
    "default": {"no_static_vehicles": False},
    "metadrive": {"horizon": 251, "truncate_as_terminate": True},
}

#: Keys of an adversary with their defaults. One of the first three attacks.
ADVERSARY: dict[str, Any] = {
    "generator": None,  # a `Generator`, at its λ
    "search": None,  # name of a driver: attacks are the plans that it fails at, searched at the first attack of each scene
    "plans": None,  # what `sage.search` found, or a dictionary of positions (n, 80, 2) by id of the scene
    "probability": 1.0,  # share of episodes with an attack
    "curriculum": None,  # of the generator's λ and the share of attacks: "paper", "release", "constant" or "adaptive"
    "total_steps": None,  # steps at which a curriculum ends: of this environment, or of all in a vector environment
    "against": "recording",  # what a generator plans against: "recording", or "drives": the newest drive in the scene
    "shared": True,  # whether the environments of a vector environment share drives and progress
    "budget": 16,  # of the search: drives in each scene
    "require": None,  # of the search: clauses of a failure
    "weights": None,  # of the search
    "adversary_type": None,  # of the search: "pedestrian" or "cyclist", if scenes have one as the adversary (`Scene.with_person`)
}

#: Keys of MetaDrive that have one meaning here. It is accepted, so that a configuration can be kept.
FIXED: dict[str, Any] = {
    "no_light": True,
    "no_traffic": False,
    "crash_object_done": True,
    "crash_human_done": False,
    "no_negative_reward": False,
    "use_lateral_reward": False,
    "lateral_penalty": 0.0,
    "heading_penalty": 0.0,
    "steering_range_penalty": 0.0,
    "crash_human_penalty": 0.0,
    "crash_human_cost": 0.0,
    "curriculum_level": 1,
    "allowed_more_steps": None,
    "physics_world_step_size": 0.02,
    "decision_repeat": 5,
    "num_agents": 1,
    "is_multi_agent": False,
    "discrete_action": False,
    "manual_control": False,
    "image_observation": False,
    "use_render": False,
}

#: The sensors of the observation.
SENSORS: dict[str, dict[str, int]] = {
    "lidar": {"num_lasers": 30, "distance": 50, "num_others": 3},
    "side_detector": {"num_lasers": 30, "distance": 50},
    "lane_line_detector": {"num_lasers": 12, "distance": 50},
}

#: Keys of the rules of the simulation.
RULES = [
    "horizon",
    "truncate_as_terminate",
    "crash_vehicle_done",
    "no_static_vehicles",
    "reactive_traffic",
    "driving_reward",
    "success_reward",
    "out_of_road_penalty",
    "crash_vehicle_penalty",
    "crash_object_penalty",
    "out_of_road_cost",
    "crash_vehicle_cost",
    "crash_object_cost",
]

#: Procedural scenes of each kind, where no others are given.
PROCEDURAL = 6


def checked(config: Config | None) -> dict[str, Any]:
    """The configuration with all keys.

    Raises `UnknownName` for a key that there is not, with the nearest one, and `OptionError` for a wrong value.
    """
    if config is not None and not isinstance(config, Mapping):
        raise OptionError(f"config is {config!r}; expected a dictionary")
    given = dict(config or {})
    _check_sensors(given.pop("vehicle_config", None))
    for key in list(given):
        if key in FIXED:
            value = given.pop(key)
            if value != FIXED[key]:
                raise OptionError(f"config: {key} is {value!r}; here it can only be {FIXED[key]!r}")
    _refuse_unknown("config", given, [*DEFAULTS, *FIXED, "vehicle_config"])
    preset = given.get("preset", DEFAULTS["preset"])
    if not isinstance(preset, str) or preset not in PRESETS:
        raise UnknownName(f"config: unknown preset {preset!r}; known: {', '.join(PRESETS)}")
    _check_values(given)
    return {**DEFAULTS, **PRESETS[preset], **given}


def _check_sensors(given: Any) -> None:
    if given is None:
        return
    if not isinstance(given, Mapping):
        raise OptionError(f"config: vehicle_config is {given!r}; expected a dictionary")
    _refuse_unknown("config: vehicle_config", given, SENSORS)
    for sensor, settings in given.items():
        if not isinstance(settings, Mapping):
            raise OptionError(f"config: vehicle_config: {sensor} is {settings!r}; expected a dictionary")
        _refuse_unknown(f"config: vehicle_config: {sensor}", settings, SENSORS[sensor])
        for key, value in settings.items():
            if value != SENSORS[sensor][key]:
                raise OptionError(
                    f"config: vehicle_config: {sensor}: {key} is {value!r}; the observation has {SENSORS[sensor][key]}"
                )


def _refuse_unknown(what: str, given: Mapping[str, Any], known: Iterable[str]) -> None:
    known = list(known)
    for key in given:
        if key not in known:
            near = difflib.get_close_matches(str(key), known, 1, cutoff=0.7)
            hint = f"the nearest is {near[0]!r}" if near else f"known: {', '.join(known)}"
            raise UnknownName(f"{what}: unknown key {key!r}; {hint}")


def _check_values(given: Mapping[str, Any]) -> None:
    for key, value in given.items():
        default = DEFAULTS[key]
        if isinstance(default, bool):
            if not isinstance(value, bool):
                raise OptionError(f"config: {key} is {value!r}; expected True or False")
        elif isinstance(default, float):
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
                raise OptionError(f"config: {key} is {value!r}; expected a finite number")
        elif isinstance(default, int) or (key == "num_scenarios" and value is not None):
            least = 0 if key in ("start_scenario_index", "worker_index") else 1
            if not _is_count(value, least):
                raise OptionError(f"config: {key} is {value!r}; expected a whole number, at least {least}")
    horizon = given.get("horizon")
    if horizon is not None and horizon != "recording":
        if not _is_count(horizon, 1):
            raise OptionError(f'config: horizon is {horizon!r}; expected a number of steps, None or "recording"')
    if given.get("data_directory") is not None and given.get("scenes") is not None:
        raise OptionError("config: data_directory and scenes exclude each other; give one of them")
    if given.get("threads", 1) > 1024:
        raise OptionError(f"config: threads is {given['threads']}; expected 1 to 1024")
    if given.get("num_workers", 1) > 1 and not given.get("sequential_seed", False):
        raise OptionError("config: num_workers divides scenes that come one after another; set sequential_seed to True")
    if given.get("worker_index", 0) >= given.get("num_workers", 1):
        raise OptionError(
            f"config: worker_index is {given.get('worker_index')}; it is below num_workers, {given.get('num_workers', 1)}"
        )


def _is_count(value: Any, least: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and least <= value < 2**53


def scenes_of(config: dict[str, Any]) -> list[Any]:
    """The scenes and paths that a checked configuration names."""
    given = config["scenes"]
    if config["data_directory"] is not None:
        all_scenes: list[Any] = list(_advsage.load_folder(config["data_directory"]).paths)
    elif given is None:
        all_scenes = list(_procedural())
    elif isinstance(given, _advsage.Scenes):
        all_scenes = list(given.paths)
    elif isinstance(given, (str, os.PathLike)):
        all_scenes = list(_advsage.load_folder(given).paths)
    elif isinstance(given, _advsage.Scene):
        all_scenes = [given]
    else:
        all_scenes = list(given)
    for path in all_scenes:
        # A record of a TFRecord file is FILE#3; other files may have # in their names.
        if isinstance(path, (str, os.PathLike)) and not any(map(os.path.exists, (path, str(path).rsplit("#", 1)[0]))):
            raise MissingFile(2, "No such file or directory", str(path))
    first, count = config["start_scenario_index"], config["num_scenarios"]
    last = len(all_scenes) if count is None else first + count
    if first >= len(all_scenes) or last > len(all_scenes):
        asked = f"start_scenario_index {first}" + ("" if count is None else f" and num_scenarios {count}")
        raise OptionError(f"config: {asked}, of {len(all_scenes)} scenes")
    return all_scenes[first:last]


def _procedural() -> Iterable[_advsage.Scene]:
    for number in range(PROCEDURAL):
        for kind in _advsage.names()["kind"]:
            try:
                yield _advsage.make(kind, 0, number)
            except OptionError:
                # Some numbers have no scene.
                continue


def rules_of(config: dict[str, Any]) -> dict[str, Any]:
    """The rules of the simulation: a preset, and what may differ from it."""
    return {key: config[key] for key in ("preset", *RULES)}


def adversary_of(config: dict[str, Any]) -> dict[str, Any] | None:
    """The adversary that a checked configuration describes."""
    given = config["adversary"]
    if given is None:
        return None
    if isinstance(given, _advsage.Generator):
        given = {"generator": given}
    elif not isinstance(given, Mapping):
        given = {"plans": given}
    _refuse_unknown("config: adversary", given, ADVERSARY)
    adversary = {**ADVERSARY, **given}
    for key in ("require", "weights", "curriculum", "adversary_type"):
        if adversary[key] is not None and not isinstance(adversary[key], str):
            raise OptionError(f"config: adversary: {key} is {adversary[key]!r}; expected a text")
    # A configuration may come from a file, so it starts no program and imports nothing.
    if any(word in str(adversary["search"] or "") for word in ("cmd:", "py:", "process")):
        raise OptionError(
            f"config: adversary: search is {adversary['search']!r}, a program; expected the name of a driver, or `plans` that sage.search found for yours"
        )
    attackers = [key for key in ("generator", "search", "plans") if adversary[key] is not None]
    if not attackers and adversary["curriculum"] is not None:
        adversary["generator"] = _advsage.Generator()
        attackers = ["generator"]
    if len(attackers) != 1:
        found = " and ".join(attackers) or "none of them"
        raise OptionError(f"config: adversary: expected one of generator, search and plans; found {found}")
    if not isinstance(adversary["probability"], (int, float)) or not 0 <= adversary["probability"] <= 1:
        raise OptionError(f"config: adversary: probability is {adversary['probability']!r}; expected 0 to 1")
    if adversary["against"] not in ("recording", "drives"):
        raise OptionError(f'config: adversary: against is {adversary["against"]!r}; expected "recording" or "drives"')
    if attackers != ["generator"]:
        for key in ("curriculum", "against"):
            if key in given:
                raise OptionError(f"config: adversary: {key} is an option of a generator, not of {attackers[0]}")
    if adversary["curriculum"] is not None:
        if "probability" in given:
            raise OptionError("config: adversary: a curriculum decides how often it attacks; leave probability out")
        # The others do not depend on the progress.
        ends = adversary["curriculum"].split("{")[0] in ("paper", "release")
        if ends and adversary["total_steps"] is None:
            raise OptionError("config: adversary: this curriculum needs total_steps, the steps of the training")
    elif "total_steps" in given:
        raise OptionError("config: adversary: total_steps is an option of a curriculum")
    if attackers != ["search"]:
        for key in ("budget", "require", "weights", "adversary_type"):
            if key in given:
                raise OptionError(f"config: adversary: {key} is an option of a search, not of {attackers[0]}")
    for key in ("total_steps", "budget"):
        if adversary[key] is not None and not _is_count(adversary[key], 1):
            raise OptionError(f"config: adversary: {key} is {adversary[key]!r}; expected a whole number, at least 1")
    if not isinstance(adversary["shared"], bool):
        raise OptionError(f"config: adversary: shared is {adversary['shared']!r}; expected True or False")
    adversary["against_drives"] = adversary.pop("against") == "drives"
    if adversary["plans"] is not None:
        adversary["plans"] = _plans(adversary["plans"])
    return adversary


def is_shared(adversary: dict[str, Any]) -> bool:
    """Whether an adversary learns from all environments of a vector environment together."""
    learns = adversary["curriculum"] is not None or adversary["against_drives"]
    return learns and bool(adversary["shared"])


def _plans(given: Any) -> list[tuple[str, Any]]:
    """Pairs of the id of a scene and positions."""
    if isinstance(given, Mapping):
        return [(str(scene), positions) for scene, positions in given.items()]
    try:
        return [(failure.scene.id, failure.trajectory) for failure in given]
    except (AttributeError, TypeError):
        raise OptionError(
            f"config: adversary: {given!r} attacks nothing; expected a Generator, what sage.search found, or a dictionary"
        ) from None

"""One environment."""

from __future__ import annotations

import warnings
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box

from .. import _advsage
from ..errors import OptionError, UnknownName
from . import _config, _picture

#: Numbers of an observation.
LENGTH = 101
Observation = np.ndarray[Any, np.dtype[np.float32]]


def spaces() -> tuple[Any, Any]:
    """The spaces of observations and actions."""
    return Box(0.0, 1.0, (LENGTH,), np.float32), Box(-1.0, 1.0, (2,), np.float32)


class ScenarioEnv(gymnasium.Env[Observation, Observation]):
    """The ego drives in a scene, in steps of 0.1 s.

    The observation is the 101 numbers of MetaDrive's vehicle, each from 0 to 1; the action steer and throttle, each from -1 to 1. The
    reward is the way along the recorded route in metres, in place of which there is +10 on arrival, -10 off the road and -1 in contact.

    `config` has the keys of `advsage.gym.DEFAULTS`. `reset(seed=...)` takes any seed and starts anew: the same seed and actions give
    the same bits. Later calls without a seed go on to the next episode. `options={"scenario": k}` chooses the scene, by its number or
    name.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}

    def __init__(self, config: _config.Config | None = None, *, render_mode: str | None = None) -> None:
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise OptionError(f"render_mode is {render_mode!r}; expected None or 'rgb_array'")
        self.render_mode = render_mode
        self.observation_space, self.action_space = spaces()
        self.config = _config.checked(config)
        workers = (self.config["worker_index"], self.config["num_workers"])
        self._environments, _ = environments(self.config, 1, "disabled", workers)
        #: Names of the scenes.
        self.scenario_names = names_of(self._environments)
        self._seeded = False
        self._picture: _picture.Picture | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begins an episode."""
        super().reset(seed=seed)
        wanted = self._scenario(options, seed)
        if seed is None and not self._seeded:
            # The same for a generator of random numbers that the user has set.
            known = self.np_random_seed
            seed = int(self.np_random.integers(2**63)) if known is None or known < 0 else known
        seed = None if seed is None else seed_of(seed)
        observation, info = self._environments.reset_one(seed, wanted)
        self._seeded = True
        warn_of(self._environments)
        return observation, info

    def _scenario(self, options: dict[str, Any] | None, seed: int | None) -> int | None:
        """Number of the scene that a reset asks for."""
        wanted = options_of(options, ["scenario"]).get("scenario")
        if wanted is not None:
            return number_of(wanted, self.scenario_names, self.config["start_scenario_index"])
        return scene_of_seed(self.config, seed, len(self.scenario_names))

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Drives for 0.1 s with an action of steer and throttle."""
        action = np.ascontiguousarray(action, np.float32)
        if action.shape != (2,):
            raise OptionError(f"the action has the shape {action.shape}; expected steer and throttle, (2,)")
        return self._environments.step_one(action)

    def __reduce__(self) -> Any:
        return refuse_copies(self)

    def render(self) -> np.ndarray[Any, np.dtype[np.uint8]] | None:  # type: ignore[override, unused-ignore]
        """A picture from above, the ego in its middle and heading up: array (480, 480, 3). None without `render_mode`."""
        if self.render_mode is None:
            return None
        if self._picture is None:
            self._picture = _picture.Picture()
        return self._picture.draw(self._environments, 0)


def refuse_copies(env: Any) -> Any:
    """What `copy` and `pickle` are told: the state of a drive cannot be copied."""
    name = type(env).__name__
    raise TypeError(f"a {name} cannot be copied or pickled; make another one from its configuration, env.config")


def environments(
    config: dict[str, Any], count: int, auto_reset: str, workers: tuple[int, int]
) -> tuple[_advsage.Environments, bool]:
    """Environments of a checked configuration, and whether an adversary learns from all of them together."""
    adversary = _config.adversary_of(config)
    share = count > 1 and adversary is not None and _config.is_shared(adversary)
    made = _advsage.Environments(
        iter(_config.scenes_of(config)),
        _config.rules_of(config),
        count=count,
        auto_reset=auto_reset,
        sequence=workers if config["sequential_seed"] else None,
        adversary=adversary,
        share=share,
        threads=min(config["threads"], count),
        in_memory=config["scenes_in_memory"],
        first=config["start_scenario_index"],
    )
    return made, share


def seed_of(seed: Any) -> int:
    """A seed as the simulation takes it, from any whole number that Gymnasium takes."""
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or seed < 0:
        raise OptionError(f"seed is {seed!r}; expected a whole number, at least 0")
    seed = int(seed)
    # A longer one is mixed, so that no bit of it is lost without a trace.
    return seed if seed < 2**64 else int(np.random.SeedSequence(seed).generate_state(1, np.uint64)[0])


def options_of(options: dict[str, Any] | None, known: list[str]) -> dict[str, Any]:
    """The options of a reset."""
    for key in options or {}:
        if key not in known:
            raise UnknownName(f"options: unknown key {key!r}; known: {', '.join(known)}")
    return options or {}


def names_of(environments: _advsage.Environments) -> list[str]:
    """Names of the scenes. Of those that are called the same, the later ones have `#` and their place behind it."""
    names: dict[str, None] = {}
    for number, name in enumerate(environments.scene_names()):
        names[name if name not in names else f"{name}#{number}"] = None
    return list(names)


def number_of(scenario: Any, names: list[str], first: int) -> int:
    """Place of a scene among those of the environment, by its number, which counts from `first`, or its name."""
    if isinstance(scenario, str):
        if scenario not in names:
            raise UnknownName(f"options: no scene is called {scenario!r}; scenario_names lists them")
        return names.index(scenario)
    if isinstance(scenario, bool) or not isinstance(scenario, (int, np.integer)):
        raise OptionError(f"options: scenario is {scenario!r}; expected the number or the name of a scene")
    number = int(scenario) - first
    if not 0 <= number < len(names):
        raise OptionError(f"options: there is no scene {scenario!r}; they are numbered {first} to {first + len(names) - 1}")
    return number


def scene_of_seed(config: dict[str, Any], seed: int | None, count: int) -> int | None:
    """With MetaDrive's preset a seed is the number of a scene, where there is one."""
    if config["preset"] != "metadrive" or seed is None:
        return None
    number = seed - config["start_scenario_index"]
    return number if 0 <= number < count else None


def warn_of(environments: _advsage.Environments) -> None:
    """Warns of scenes that could not be used, and of attacks that could not be planned."""
    for scene, problem in environments.take_notes():
        text = problem.removeprefix(f"scene `{scene}`: ")
        warnings.warn(f"scene `{scene}`: {text}", RuntimeWarning, stacklevel=3)

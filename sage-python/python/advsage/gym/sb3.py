"""Vector environments for Stable-Baselines3.

    from stable_baselines3 import PPO
    from advsage.gym.sb3 import ScenarioVecEnv

    model = PPO("MlpPolicy", ScenarioVecEnv(16, {"data_directory": "scenes/"}))
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecEnv

from ._config import Config
from ._environment import options_of
from ._vector import ScenarioVectorEnv

#: Infos of an episode that has ended, for `EvalCallback(..., is_success)` and logs.
OF_EPISODE = ("arrive_dest", "out_of_road", "crash_vehicle", "route_completion", "cost", "scenario_index", "under_attack")


class ScenarioVecEnv(VecEnv):
    """`ScenarioVectorEnv` as Stable-Baselines3 has vector environments.

    The list of infos is empty but for episodes that have ended: these have `terminal_observation`, `TimeLimit.truncated`, `episode`
    (return `r` and length `l`, as its `Monitor` writes them), `is_success`, and some of MetaDrive's keys. `columns` are all infos of
    the last step, as `ScenarioVectorEnv` has them, such as `columns["cost"]`.
    """

    def __init__(self, num_envs: int, config: Config | None = None, *, render_mode: str | None = None) -> None:
        #: The vector environment.
        self.envs = ScenarioVectorEnv(
            num_envs, config, autoreset_mode=AutoresetMode.SAME_STEP, render_mode=render_mode
        )
        # The base class asks for it.
        self.render_mode = render_mode
        self._actions: np.ndarray[Any, Any] | None = None
        #: Infos of the last step.
        self.columns: dict[str, Any] = {}
        super().__init__(num_envs, self.envs.single_observation_space, self.envs.single_action_space)

    def reset(self) -> Any:
        """Begins an episode in every environment."""
        given, options = self._seeds, self._options
        seed = None if all(one is None for one in given) else given
        scenario = [options_of(one, ["scenario"]).get("scenario") for one in options] if any(options) else None
        observations, self.columns = self.envs.reset(seed=seed, options=None if scenario is None else {"scenario": scenario})
        self._reset_seeds()
        self._reset_options()
        self.reset_infos = [{} for _ in range(self.num_envs)]
        return observations

    def step_async(self, actions: np.ndarray[Any, Any]) -> None:
        """Takes the actions of a step."""
        self._actions = actions

    def step_wait(self) -> Any:
        """Steps."""
        observations, rewards, terminated, truncated, columns = self.envs.step(self._actions)
        self.columns = columns
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        done = terminated | truncated
        if "final_obs" in columns:
            last = columns["final_info"]
            for k in np.flatnonzero(done):
                infos[k] = {key: last[key][k].item() for key in OF_EPISODE if key in last}
                infos[k]["terminal_observation"] = columns["final_obs"][k]
                infos[k]["TimeLimit.truncated"] = bool(truncated[k] and not terminated[k])
                infos[k]["is_success"] = infos[k]["arrive_dest"]
                infos[k]["episode"] = {"r": last["episode_reward"][k].item(), "l": last["episode_length"][k].item()}
        return observations, rewards.astype(np.float32), done, infos

    def close(self) -> None:
        """Closes it."""
        self.envs.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute, which all environments share."""
        return [getattr(self.envs, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Sets an attribute, which all environments share."""
        setattr(self.envs, attr_name, value)

    def env_method(self, method_name: str, *arguments: Any, indices: Any = None, **keywords: Any) -> list[Any]:
        """Calls a method, which all environments share."""
        result = getattr(self.envs, method_name)(*arguments, **keywords)
        return [result for _ in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """Episodes are recorded as by `Monitor`; nothing else is wrapped."""
        return [issubclass(Monitor, wrapper_class) for _ in self._get_indices(indices)]

    def get_images(self) -> Sequence[np.ndarray[Any, Any] | None]:
        """A picture of every environment."""
        return self.envs.render() or [None] * self.num_envs

"""Environments of Gymnasium: the ego drives, in recorded or procedural scenes, against an adversary.

    import advsage.gym
    import gymnasium

    env = gymnasium.make("advsage/Scenario-v0", config={"data_directory": "scenes/"})
    envs = gymnasium.make_vec("advsage/Scenario-v0", num_envs=16, config={"data_directory": "scenes/"})

`ScenarioEnv` has the configuration keys and infos of MetaDrive's `ScenarioEnv` where they mean the same. `ScenarioVectorEnv` steps many
environments in one call. `advsage.gym.sb3` is the way to Stable-Baselines3. Needs `pip install "advsage[gym]"`.
"""

import importlib.util

if importlib.util.find_spec("gymnasium") is None:
    raise ImportError('advsage.gym needs Gymnasium: pip install "advsage[gym]"')

import gymnasium

from ._config import DEFAULTS, Config
from ._environment import ScenarioEnv
from ._vector import ScenarioVectorEnv

__all__ = ["DEFAULTS", "Config", "ScenarioEnv", "ScenarioVectorEnv"]

#: Name of the environment in Gymnasium's registry.
NAME = "advsage/Scenario-v0"

if NAME not in gymnasium.registry:
    gymnasium.register(
        NAME, entry_point="advsage.gym:ScenarioEnv", vector_entry_point="advsage.gym:ScenarioVectorEnv"
    )

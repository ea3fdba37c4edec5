"""A policy that `train.py` has trained, as a driver of the command.

sage simulate scenes/ --ego py:trained:Trained      (in the folder of this file and of policy.zip)
"""

from typing import Any

from advsage.planner import Observation
from stable_baselines3 import PPO


class Trained:
    """Drives by the policy of `policy.zip`."""

    def __init__(self) -> None:
        self.model = PPO.load("policy", device="cpu")

    def act(self, obs: Observation) -> Any:
        action, _ = self.model.predict(obs.vector(), deterministic=True)
        return action

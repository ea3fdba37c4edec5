"""Trains a driving policy with PPO against an adversary, saves it, and tests it.

python3 train.py [FOLDER] [STEPS]     (needs pip install "advsage[gym]" stable-baselines3)
"""

import sys

import torch
from advsage.gym import ScenarioVectorEnv
from advsage.gym.sb3 import ScenarioVecEnv
from stable_baselines3 import PPO

import advsage as sage


def main(folder: str | None = None, steps: str = "20000") -> None:
    torch.set_num_threads(1)  # small networks are slower on more
    scenes = {} if folder is None else {"data_directory": folder}
    adversary = {"curriculum": "paper", "total_steps": int(steps)}
    envs = ScenarioVecEnv(16, {**scenes, "adversary": adversary})
    model = PPO("MlpPolicy", envs, n_steps=128, seed=0)
    model.learn(int(steps))
    model.save("policy")
    print("wrote policy.zip")

    # One episode in each environment, without an adversary and with one.
    for name, attack in [("recorded", None), ("attacked", sage.Generator())]:
        tested = ScenarioVectorEnv(16, {**scenes, "adversary": attack}, autoreset_mode="Disabled")
        observations, infos = tested.reset(seed=1)
        completion, crashed, over = infos["route_completion"], infos["crash_vehicle"], infos["max_step"]
        while not over.all():
            # An episode that is over begins another one, which is not counted.
            observations, _, terminated, truncated, infos = tested.step(model.predict(observations, deterministic=True)[0])
            completion[~over], crashed[~over] = infos["route_completion"][~over], (crashed | infos["crash_vehicle"])[~over]
            over, ended = over | terminated | truncated, terminated | truncated
            if ended.any():
                observations, _ = tested.reset(options={"reset_mask": ended})
        print(f"{name}: route completion {completion.mean():.2f}, contact in {crashed.mean():.0%} of 16 episodes")


if __name__ == "__main__":
    main(*sys.argv[1:])

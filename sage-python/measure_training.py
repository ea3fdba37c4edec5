"""Trains driving policies by PPO of Stable-Baselines3 and evaluates them: a row for each seed, then means and deviations.

python3 measure_training.py TRAIN EVAL [--splits FILE --split NAME] [--settings cleanrl|large] [--steps N] [--seeds N]

TRAIN and EVAL are folders of scenes. `cleanrl` has the settings of CleanRL's PPO for continuous actions, in 16 environments; `large` larger
batches from 128 environments. Each policy drives once in each scene of EVAL, without noise, and contact ends the episode.
"""

import argparse
import json
import os
import statistics
import time

import advsage as sage
import numpy as np
import torch
from advsage.gym import ScenarioVectorEnv
from advsage.gym.sb3 import ScenarioVecEnv
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize

#: Environments, and arguments of PPO.
SETTINGS = {
    "cleanrl": (
        16,
        {
            "learning_rate": lambda left: 3e-4 * left,
            "n_steps": 128,
            "batch_size": 64,
            "n_epochs": 10,
            "gamma": 0.99,
            "policy_kwargs": {"net_arch": [64, 64], "activation_fn": torch.nn.Tanh},
        },
    ),
    "large": (
        128,
        {
            "learning_rate": lambda left: 1e-3 * left,
            "n_steps": 32,
            "batch_size": 1024,
            "n_epochs": 4,
            "gamma": 0.97,
            "policy_kwargs": {
                "net_arch": {"pi": [128, 128], "vf": [128, 128]},
                "activation_fn": torch.nn.ReLU,
                "log_std_init": -0.693,
                "optimizer_kwargs": {"eps": 1e-5},
            },
        },
    ),
}
#: What is reported of the last step of each episode.
MEASURED = ["route_completion", "crash_vehicle", "out_of_road", "arrive_dest", "episode_reward"]


def trained(scenes, settings, steps, seed):
    """A policy, and the normalisation that it was trained behind."""
    count, arguments = SETTINGS[settings]
    envs = ScenarioVecEnv(count, {"scenes": scenes})
    envs = VecNormalize(envs, clip_obs=10.0, clip_reward=10.0, gamma=arguments["gamma"])
    model = PPO("MlpPolicy", envs, gae_lambda=0.95, clip_range=0.2, ent_coef=0.0, max_grad_norm=0.5, seed=seed, **arguments)
    model.learn(steps)
    return model, envs


def evaluated(model, normalize, folder):
    """Means over the scenes of a folder."""
    count = len(sage.load_folder(folder))
    config = {"data_directory": folder, "crash_vehicle_done": True}
    envs = ScenarioVectorEnv(count, config, autoreset_mode="Disabled")
    each = {"scenario": list(range(count))}
    observations, _ = envs.reset(seed=0, options=each)
    over, rows = np.zeros(count, bool), {key: np.zeros(count) for key in MEASURED}
    while not over.all():
        actions, _ = model.predict(normalize.normalize_obs(observations), deterministic=True)
        observations, _, terminated, truncated, infos = envs.step(actions)
        ended = terminated | truncated
        for key, values in rows.items():
            # Episodes that begin again to keep the others company are not counted.
            values[ended & ~over] = infos[key][ended & ~over]
        over |= ended
        if ended.any():
            observations, _ = envs.reset(options={**each, "reset_mask": ended})
    return {key: float(values.mean()) for key, values in rows.items()}


def main():
    """Trains and evaluates."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("train")
    parser.add_argument("eval")
    parser.add_argument("--splits")
    parser.add_argument("--split", default="train")
    parser.add_argument("--settings", choices=SETTINGS, default="cleanrl")
    parser.add_argument("--steps", type=int, default=200_000)
    parser.add_argument("--seeds", type=int, default=5)
    given = parser.parse_args()
    torch.set_num_threads(1)
    scenes = sage.load_folder(given.train).paths
    if given.splits:
        with open(given.splits) as file:
            chosen = {str(name) for name in json.load(file)[given.split]}
        scenes = [path for path in scenes if os.path.splitext(os.path.basename(path))[0] in chosen]
    print(f"{len(scenes)} scenes, {given.settings}, {given.steps} steps")
    rows = []
    for seed in range(given.seeds):
        clock = time.process_time()
        model, normalize = trained(scenes, given.settings, given.steps, seed)
        seconds = time.process_time() - clock
        rows.append(evaluated(model, normalize, given.eval))
        print(f"seed {seed}, {seconds:.0f} s:", ", ".join(f"{key} {value:.3f}" for key, value in rows[-1].items()), flush=True)
    for key in MEASURED:
        values = [row[key] for row in rows]
        spread = f", standard deviation {statistics.stdev(values):.3f}" if len(values) > 1 else ""
        print(f"{key}: mean {statistics.mean(values):.3f}{spread}")


if __name__ == "__main__":
    main()

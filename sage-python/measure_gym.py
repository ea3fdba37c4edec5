"""Measures the environments against the same steps in Rust, in turn: steps per second on one core, and resident size.

python3 measure_gym.py FILE... (16 scenes; needs target/release/examples/step_environments, and MetaDrive's Python in
SAGE_METADRIVE_PYTHON for its row)
"""

import json
import pathlib
import statistics
import subprocess
import sys
import time

import advsage.gym
import gymnasium
import numpy as np

STEPS = 20_000
RUST = pathlib.Path(__file__).resolve().parents[1] / "target" / "release" / "examples" / "step_environments"


#: The action of each step, which Rust computes as well.
ACTIONS = np.array([[(step * 7 % 11 - 5) / 50, (step * 5 % 13 - 3) / 20] for step in range(STEPS)], np.float32)


def vector(files, mode="same_step", roll_out=None, **keywords):
    """Steps per second of a vector environment."""
    count = len(files)
    config = {"scenes": files, "sequential_seed": True, **keywords}
    envs = advsage.gym.ScenarioVectorEnv(count, config, autoreset_mode=gymnasium.vector.AutoresetMode.SAME_STEP)
    actions = np.repeat(ACTIONS[None], count, 0)
    for _ in range(2):
        envs.reset(seed=0)
        clock, rewards = time.process_time(), 0.0
        if roll_out:
            for first in range(0, STEPS // count, roll_out):
                rewards += envs.roll_out(actions[:, first : first + roll_out])[1].sum()
        else:
            for step in range(STEPS // count):
                rewards += envs.step(actions[:, step])[1].sum()
        rate = STEPS // count * count / (time.process_time() - clock)
    return rate, rewards


def single(files, make):
    """Steps per second of one environment."""
    env = make({"scenes": files, "sequential_seed": True})
    for _ in range(2):
        env.reset(seed=0)
        clock, rewards = time.process_time(), 0.0
        for step in range(STEPS):
            _, reward, terminated, truncated, _ = env.step(ACTIONS[step])
            rewards += reward
            if terminated or truncated:
                env.reset()
        rate = STEPS / (time.process_time() - clock)
    return rate, rewards


def main(*files):
    files = list(files)
    rows = {}
    for _ in range(5):
        rust = json.loads(subprocess.run([RUST, *files], capture_output=True, text=True, check=True).stdout)
        runs = {
            "vector environment": (*vector(files), "lockstep"),
            "vector environment, roll-outs of 125": (*vector(files, roll_out=125), "roll_out"),
            "ScenarioEnv": (*single(files, advsage.gym.ScenarioEnv), "single"),
            "gymnasium.make": (*single(files, lambda config: gymnasium.make(advsage.gym.NAME, config=config)), "single"),
        }
        for name, (rate, rewards, of) in runs.items():
            assert abs(rewards - rust[f"{of}_rewards"]) < 1e-2, (name, rewards, rust)
            rows.setdefault(name, []).append((rate, rate / rust[of], rust[of]))
    for name, found in rows.items():
        rates, ratios, rust = zip(*found)
        print(
            f"{name}: {statistics.median(rates):.0f} steps/s, {statistics.median(ratios):.3f} of Rust's "
            f"{statistics.median(rust):.0f} (runs {min(ratios):.3f} to {max(ratios):.3f})"
        )


if __name__ == "__main__":
    main(*sys.argv[1:])

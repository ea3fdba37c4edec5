"""Measures the environments against the same steps in Rust, in turn: steps per second of CPU time on one core.

python3 measure_gym.py FILE... (16 scenes; needs `cargo build --release -p sage-sim --example step_environments`). MetaDrive steps through
three of them, where SAGE_METADRIVE_PYTHON names a Python that has it.
"""

import json
import os
import pathlib
import shutil
import statistics
import subprocess
import sys
import tempfile
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


#: Steps of MetaDrive with the sensors of our observation, in scenes of a folder.
METADRIVE = """
import os, pickle, sys, time
from metadrive.engine.base_engine import BaseEngine
from metadrive.envs.scenario_env import ScenarioEnv
# Without pictures its models are not needed, which it would load from the network.
BaseEngine.try_pull_asset = lambda self: None
folder = sys.argv[1]
count = len(pickle.load(open(os.path.join(folder, "dataset_summary.pkl"), "rb")))
env = ScenarioEnv(dict(data_directory=folder, num_scenarios=count, no_light=True, no_static_vehicles=True, log_level=50, horizon=90,
    vehicle_config=dict(lidar=dict(num_lasers=30, distance=50, num_others=3), side_detector=dict(num_lasers=30, distance=50),
    lane_line_detector=dict(num_lasers=12, distance=50))))
for lap in range(2):
    steps, clock = 0, time.process_time()
    for number in range(count):
        env.reset(seed=number)
        for step in range(60):
            over = env.step([0.0, 0.1])
            steps += 1
            if over[2] or over[3]:
                break
    seconds = time.process_time() - clock
print("rate", steps / seconds)
"""


def metadrive(files):
    """Steps per second of MetaDrive; None where it is not installed."""
    python = os.environ.get("SAGE_METADRIVE_PYTHON")
    if not python:
        return None
    with tempfile.TemporaryDirectory() as folder:
        os.mkdir(f"{folder}/scenes")
        for file in files:
            shutil.copy(file, f"{folder}/scenes")
        sage = RUST.parents[1] / "sage"
        # Of the formats it is this one that has the summary that MetaDrive reads.
        words = ["--lambda", "0", "--format", "pickle", "--no-pages", "--quiet", "--out", f"{folder}/data"]
        subprocess.run([sage, "generate", f"{folder}/scenes", *words], check=True, capture_output=True)
        done = subprocess.run([python, "-c", METADRIVE, f"{folder}/data"], check=True, capture_output=True, text=True)
        return float(done.stdout.split("rate ")[1])


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
    rate = metadrive(files[:3])
    print("MetaDrive: left out (SAGE_METADRIVE_PYTHON)" if rate is None else f"MetaDrive: {rate:.0f} steps/s")


if __name__ == "__main__":
    main(*sys.argv[1:])

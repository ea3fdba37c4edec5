"""Scores trajectories of the adversary: its recording, and others that lead more and more to where the ego is.

python3 score.py [SCENE]
"""

import sys

import numpy as np

import advsage as sage


def main(path: str | None = None) -> None:
    scene = sage.load(path) if path else sage.make("four-way", seed=1)
    if scene.adversary is None:
        sys.exit("the scene has no adversary; name one: sage.load(path, adversary=...)")
    logged = scene.positions[scene.adversary, 11:91, :2]
    ego = scene.positions[scene.ego, 11:91, :2]
    grows = np.linspace(0.0, 1.0, 80)[:, None]
    candidates = np.stack([logged + share * grows * (ego - logged) for share in (0.0, 0.25, 0.5, 1.0)])
    columns = sage.score_columns(scene, candidates)
    for name in ("adversarial_reward", "collision_step", "kinematic_penalty", "feasible"):
        print(f"{name:20}", columns[name].round(2))
    worst = sage.score(scene, candidates)[-1]
    print("the last one breaks:", [violation["rule"] for violation in worst["violations"]] or "no rule")


if __name__ == "__main__":
    main(*sys.argv[1:])

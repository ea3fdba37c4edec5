"""Attacks a folder of scenes with Ray: tasks get paths, and each worker loads the weights once.

python3 ray_tasks.py [FOLDER]

To write the files of `sage generate` instead: python3 -m advsage.jobs generate FOLDER --out DIR --engine ray
"""

import sys
import tempfile
from typing import Any

import advsage as sage


KEPT: dict[float, sage.Generator] = {}


def generator(lambda_: float) -> sage.Generator:
    """One a process: loading weights takes longer than an attack."""
    if lambda_ not in KEPT:
        KEPT[lambda_] = sage.Generator(lambda_=lambda_)
    return KEPT[lambda_]


def attack(path: str, lambda_: float) -> dict[str, Any]:
    attack = generator(lambda_)(sage.load(path))
    return {"scene": path, "trajectory": attack.trajectory, "hit": attack.scores["collision"], "feasible": attack.feasible}


def main(folder: str | None = None) -> None:
    import ray

    ray.init(num_cpus=2, include_dashboard=False, logging_level=40)
    if folder is None:
        folder = tempfile.mkdtemp()
        for k in range(8):
            scene = sage.make("four-way", 1, k)
            scene.save(f"{folder}/{scene.id}.pkl")
    # A task is tried again if its worker dies; what a scene raises is raised here.
    task = ray.remote(num_cpus=1, max_retries=3)(attack)
    rows = ray.get([task.remote(path, 1.0) for path in sage.load_folder(folder).paths])
    print(f"{sum(bool(row['hit']) for row in rows)} of {len(rows)} hit the ego")
    ray.shutdown()


if __name__ == "__main__":
    main(*sys.argv[1:])

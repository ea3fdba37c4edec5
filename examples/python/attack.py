"""Attacks scenes at rising aggression and writes the attacked ones.

python3 attack.py [FOLDER]
"""

import sys
from collections.abc import Iterable

import advsage as sage


def main(folder: str | None = None) -> None:
    scenes: Iterable[sage.Scene | str]
    scenes = sage.load_folder(folder).paths if folder else [sage.make("four-way", 1, k) for k in range(8)]
    scenes = list(scenes)
    for lambda_ in (0.0, 0.5, 1.0):
        generator = sage.Generator(lambda_=lambda_)
        hits = feasible = 0
        for attack in sage.generate_many(generator, scenes):
            hits += bool(attack.scores["collision"])
            feasible += bool(attack.scores["collision"]) and attack.feasible
            if lambda_ == 1.0:
                attack.scene.save(f"{attack.scene.name}-attacked.pkl")
        print(f"lambda {lambda_}: {hits} of {len(scenes)} hit the ego, {feasible} of them feasibly")


if __name__ == "__main__":
    main(*sys.argv[1:])

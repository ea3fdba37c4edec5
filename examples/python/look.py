"""Looks at a scene: what it holds, what it can be used for, and a picture.

python3 look.py [SCENE]
"""

import sys

import advsage as sage


def main(path: str | None = None) -> None:
    scene = sage.load(path) if path else sage.make("four-way", seed=1)
    print(scene)
    now = 10
    ego, others = scene.positions[scene.ego, now, :2], scene.valid[:, now]
    near = ((scene.positions[:, now, :2] - ego) ** 2).sum(axis=1) ** 0.5 < 30.0
    print(f"{int((near & others).sum()) - 1} road users within 30 m of the ego")
    row = sage.inspect(scene)
    print("warnings:", [warning["kind"] for warning in row["warnings"]] or "none")
    print("cannot be attacked because:", row["capabilities"]["attack"] or "it can")
    sage.draw(scene).save("scene.svg")
    print("wrote scene.svg")


if __name__ == "__main__":
    main(*sys.argv[1:])

"""Puts a planner into the ego's seat and attacks it.

python3 stress.py [FOLDER]
"""

import sys
from collections.abc import Iterable

import advsage as sage
from advsage.planner import Observation, Scene


class MyPlanner:
    """Follows the route and brakes for the car ahead."""

    def reset(self, scene: Scene, seed: int) -> None:
        self.route = scene.route

    def act(self, obs: Observation) -> tuple[float, float]:
        speed = max(obs.ego.speed, 0.0)
        gap = max(obs.leader_gap(self.route), 0.1)
        acceleration = 1.5 * (1 - (speed / 12) ** 4 - ((2 + 1.5 * speed) / gap) ** 2)
        return obs.steer_to(self.route, ahead=2 + 0.3 * speed), obs.scene.car.throttle_for(acceleration)


def main(folder: str | None = None) -> None:
    scenes: Iterable[sage.Scene | str]
    scenes = sage.load_folder(folder).paths if folder else [sage.make("four-way", 1, k) for k in range(6)]
    scenes = list(scenes)
    # A planner keeps what its drive needs in `self`, so it drives one scene after the other.
    result = sage.stress(MyPlanner(), scenes, sage.Generator(lambda_=1.0))
    print(result.table())
    print(sage.stress("expert", scenes).table())
    for episode in result:
        if episode.verdict and episode.verdict["at_fault"]:
            print(episode)
            with open("drive.html", "w") as page:
                page.write(episode.html())
            print("wrote drive.html")
            break
    # Plans that were searched with the driver in the loop. All clauses would also ask for its fault and for a way out.
    found = sage.search(scenes[:2], MyPlanner(), budget=12, require="attack,believable")
    print(found)
    for failure in found[:3]:
        print(failure)


if __name__ == "__main__":
    main(*sys.argv[1:])

"""What Python costs beside the libraries, for `docs/results/engineering.md`.

    SAGE_COMMAND=target/release/sage python3 sage-python/measure.py [FOLDER OF SCENES]

Timings are medians of one process on one core, but for the threads.
"""

import json
import os
import statistics
import subprocess
import sys
import tempfile
import time

import advsage as sage
from advsage import _advsage

KINDS = ["four-way", "merge", "straight", "t-junction", "curve", "roundabout", "divided"]


def beside(call, count):
    """Median seconds of a call outside the libraries, and as a whole."""
    outside, whole = [], []
    for _ in range(count):
        inside, clock = _advsage._seconds(), time.perf_counter()
        call()
        taken = time.perf_counter() - clock
        outside.append(taken - (_advsage._seconds() - inside))
        whole.append(taken)
    return statistics.median(outside), statistics.median(whole)


def main(folder=None):
    if folder:
        paths = sage.load_folder(folder).paths
    else:
        folder = tempfile.mkdtemp()
        for k in range(56):
            scene = sage.make(KINDS[k % 7], 5, k // 7)
            scene.save(f"{folder}/{scene.id}.pkl")
        paths = sage.load_folder(folder).paths
    scenes = [sage.load(path) for path in paths]
    generator = sage.Generator(lambda_=1.0)
    scene = scenes[0]
    attack = generator(scene)
    print(f"{len(scenes)} scenes of {folder}")
    for name, call in [
        ("load", lambda: sage.load(paths[0])),
        ("generate", lambda: generator(scene)),
        ("score, one candidate", lambda: sage.score(scene, attack.trajectory)),
        (f"score, {len(attack.candidates)} candidates", lambda: sage.score(scene, attack.candidates)),
    ]:
        outside, whole = beside(call, 200)
        print(f"{name}: {1e3 * outside:.3f} ms outside the libraries, {1e3 * whole:.2f} ms in all")

    # CPU time of the whole attack, each scene once, in turn with the command's own.
    def own():
        times = []
        for one in scenes:
            clock = time.process_time()
            generator(one)
            times.append(time.process_time() - clock)
        return statistics.median(times)

    def theirs():
        with tempfile.TemporaryDirectory() as out:
            command = [os.environ.get("SAGE_COMMAND", "sage"), "generate", folder, "--lambda", "1", "--format", "rows"]
            subprocess.run([*command, "--no-pages", "--quiet", "--threads", "1", "--out", out], check=True, capture_output=True)
            with open(f"{out}/run.json") as file:
                return json.load(file)["per_attack"]["seconds"]

    own()
    pairs = [(own(), theirs()) for _ in range(7)]
    ratios = ", ".join(f"{ours / command:.2f}" for ours, command in sorted(pairs, key=lambda pair: pair[0] / pair[1]))
    own, theirs = (1e3 * statistics.median(times) for times in zip(*pairs))
    print(f"attack: {own:.2f} ms of CPU time, the median over scenes, seven runs; the command's {theirs:.2f} ms; ratios {ratios}")

    def many(threads):
        clock = time.perf_counter()
        for _ in sage.generate_many(generator, scenes, threads=threads):
            pass
        return time.perf_counter() - clock

    many(2)
    one, two = min(many(1) for _ in range(5)), min(many(2) for _ in range(5))
    print(f"generate_many: two threads {one / two:.2f} times as fast as one")

    class Constant:
        def act(self, obs):
            return 0.0, 0.1

    class Reader(Constant):
        def act(self, obs):
            obs.ego, obs.ego_row, obs.agents, obs.agent_ids, obs.agent_rows, obs.agent_history, obs.agent_mask
            obs.lights, obs.vector(), obs.scene.lanes, obs.scene.edges, obs.scene.route.array, obs.scene.map
            return 0.0, 0.1

    def step(planner):
        steps, clock = 0, time.perf_counter()
        for one in scenes:
            steps += len(sage.simulate(one, planner).trajectory) - 1
        return (time.perf_counter() - clock) / steps

    base = min(step('constant{"throttle": 0.1}') for _ in range(5))
    for name, planner in [("a constant control", Constant()), ("every field read", Reader())]:
        cost = min(step(planner) for _ in range(5)) - base
        print(f"planner, {name}: {1e3 * cost:.3f} ms a step more than a constant driver of the library")


if __name__ == "__main__":
    main(*sys.argv[1:])

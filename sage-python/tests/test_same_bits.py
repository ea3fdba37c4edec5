"""The module gives the bits of the command, from every kind of process."""

import hashlib
import json
import multiprocessing
import os
import pathlib
import signal
import tempfile
import unittest

import numpy as np

import advsage as sage
from support import COMMAND, command, needs, scene_files

LAMBDAS = (0.0, 0.5, 1.0)
#: Seconds that a process has: one that hangs fails the test.
LIMIT = 60
COUNT = int(os.environ.get("SAGE_SCENES", "60"))


def known(value):
    """A number; None for NaN, which a refined plan has in place of a log-probability and a goal."""
    return None if value != value else value


def digest(attack):
    """Hash over all that is compared: trajectory, candidates, log-probabilities, goals, scores."""
    hasher = hashlib.blake2b()
    for array in (attack.trajectory, attack.candidates, attack.log_probs, attack.goals):
        hasher.update(np.ascontiguousarray(array).tobytes())
    hasher.update(json.dumps([attack.chosen, attack.scores, attack.candidate_scores], sort_keys=True).encode())
    return hasher.hexdigest()


def digests_of(paths, lambda_):
    """In this process, one call after the other."""
    generator = sage.Generator(lambda_=lambda_)
    return [digest(generator(sage.load(path))) for path in paths]


def digests_of_many(paths, lambda_, threads=2):
    return [digest(attack) for attack in sage.generate_many(sage.Generator(lambda_=lambda_), paths, threads=threads)]


def _child(work, paths, lambda_, results):
    results.put(work(paths, lambda_))


def in_process(method, work, paths, lambda_):
    """What a child process finds, started by a method of `multiprocessing`."""
    context = multiprocessing.get_context(method)
    results = context.Queue()
    child = context.Process(target=_child, args=(work, paths, lambda_, results))
    child.start()
    try:
        return results.get(timeout=LIMIT)
    finally:
        child.join(5)
        if child.is_alive():
            child.kill()


class SameBits(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls._folder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(cls._folder.cleanup)
        folder = pathlib.Path(cls._folder.name)
        scenes = folder / "scenes"
        scenes.mkdir()
        cls.paths = scene_files(COUNT, scenes)
        for path in cls.paths:
            if not (scenes / os.path.basename(path)).exists():
                (scenes / os.path.basename(path)).symlink_to(os.path.abspath(path))
        command(
            "generate", scenes, "--lambda", ",".join(map(str, LAMBDAS)), "--format", "rows", "--no-pages", "--quiet",
            "--out", folder / "out",
        )
        cls.rows = {}
        for path in cls.paths:
            name = os.path.basename(path).rsplit(".", 1)[0]
            for lambda_ in LAMBDAS:
                with open(folder / "out" / f"{name}-lambda{lambda_:.2f}.json") as file:
                    cls.rows[path, lambda_] = json.load(file)
        cls.expected = {lambda_: digests_of(cls.paths, lambda_) for lambda_ in LAMBDAS}

    def test_one_process(self):
        for lambda_ in LAMBDAS:
            generator = sage.Generator(lambda_=lambda_)
            for path in self.paths:
                attack, row = generator(sage.load(path)), self.rows[path, lambda_]
                with self.subTest(path=path, lambda_=lambda_):
                    self.assertEqual(attack.trajectory.tolist(), row["trajectory"])
                    self.assertEqual(attack.chosen, row["chosen"])
                    self.assertEqual(attack.feasible, row["feasible"])
                    self.assertEqual(attack.note, row["note"])
                    self.assertEqual(len(attack.candidates), len(row["candidates"]))
                    expected = [candidate["trajectory"] for candidate in row["candidates"]]
                    self.assertEqual(attack.candidates.tolist(), expected)
                    log_probs = [candidate["log_prob"] for candidate in row["candidates"]]
                    self.assertEqual([known(value) for value in attack.log_probs.tolist()], log_probs)
                    goals = [None if known(goal[0]) is None else goal for goal in attack.goals.tolist()]
                    self.assertEqual(goals, [candidate["goal"] for candidate in row["candidates"]])
                    self.assertEqual(attack.candidate_scores, [candidate["scores"] for candidate in row["candidates"]])
                    for name, value in attack.scores.items():
                        self.assertEqual(value, row["scores"][name], name)

    def test_threads(self):
        for threads in (1, 2):
            for lambda_ in LAMBDAS:
                self.assertEqual(digests_of_many(self.paths, lambda_, threads), self.expected[lambda_])

    def test_other_processes(self):
        for method in ("spawn", "forkserver"):
            for lambda_ in LAMBDAS:
                with self.subTest(method=method, lambda_=lambda_):
                    self.assertEqual(in_process(method, digests_of, self.paths, lambda_), self.expected[lambda_])
                    self.assertEqual(in_process(method, digests_of_many, self.paths, lambda_), self.expected[lambda_])

    def test_fork_after_a_call_in_the_parent(self):
        for before in (digests_of, digests_of_many):
            for inside in (digests_of, digests_of_many):
                for lambda_ in LAMBDAS:
                    with self.subTest(before=before.__name__, inside=inside.__name__, lambda_=lambda_):
                        before(self.paths[:3], lambda_)
                        self.assertEqual(in_process("fork", inside, self.paths, lambda_), self.expected[lambda_])

    @needs("ray", "the comparison with Ray's tasks and data")
    def test_ray(self):
        import ray

        from ray_support import ray_cluster

        with ray_cluster():
            task = ray.remote(num_cpus=1)(digests_of)
            for lambda_ in LAMBDAS:
                halves = [self.paths[::2], self.paths[1::2]]
                first, second = ray.get([task.remote(half, lambda_) for half in halves])
                merged = [None] * len(self.paths)
                merged[::2], merged[1::2] = first, second
                self.assertEqual(merged, self.expected[lambda_])
                by_path = attacked_by_ray_data(self.paths, lambda_)
                self.assertEqual([by_path[path] for path in self.paths], self.expected[lambda_])


class Attacker:
    """An actor of Ray Data: it loads weights once."""

    def __init__(self, lambda_):
        self.generator = sage.Generator(lambda_=lambda_)

    def __call__(self, batch):
        digests = [digest(self.generator(sage.load(str(path)))) for path in batch["item"]]
        return {"path": batch["item"], "digest": np.array(digests)}


def attacked_by_ray_data(paths, lambda_):
    """Digests by path, from two actors."""
    import ray

    data = ray.data.from_items(paths, override_num_blocks=4)
    compute = ray.data.ActorPoolStrategy(size=2)
    rows = data.map_batches(Attacker, fn_constructor_args=(lambda_,), batch_size=4, compute=compute, num_cpus=1)
    return {row["path"]: row["digest"] for row in rows.take_all()}


if __name__ == "__main__":
    signal.alarm(1800)
    unittest.main()

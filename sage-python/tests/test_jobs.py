"""Large runs: files of the command, workers that are killed, shards that are run again."""

import json
import os
import pathlib
import random
import re
import signal
import subprocess
import sys
import threading
import time
import unittest

import advsage as sage
from support import InFolder, command, needs, procedural
from test_same_bits import digests_of

JOBS = [sys.executable, "-m", "advsage.jobs"]
#: Fields that say which run a row is of.
OF_RUN = ("run_hash",)


def rows(folder):
    """Rows of a folder by file name, without what says which run they are of."""
    found = {}
    for path in pathlib.Path(folder).glob("*-lambda*.json"):
        row = json.loads(path.read_text())
        found[path.name] = {name: value for name, value in row.items() if name not in OF_RUN}
    return found


class Jobs(InFolder):
    def setUp(self):
        super().setUp()
        self.scenes = pathlib.Path(self.folder) / "scenes"
        self.scenes.mkdir()
        for scene in procedural(14):
            scene.save(self.scenes / f"{scene.id}.pkl")

    def words(self, out):
        return ["generate", str(self.scenes), "--lambda", "0,1", "--no-pages", "--quiet", "--out", os.path.join(self.folder, out)]

    def job(self, *words, code=0):
        done = subprocess.run([*JOBS, *words], capture_output=True, text=True)
        self.assertEqual(done.returncode, code, done.stderr)
        return done

    def same_as_the_command(self, out):
        whole = os.path.join(self.folder, "whole")
        if not os.path.exists(whole):
            command(*self.words("whole"))
        own, expected = os.path.join(self.folder, out), rows(whole)
        self.assertEqual(rows(own), expected)
        self.assertEqual(len(expected), 28)

        def names(folder):
            return sorted(name for name in os.listdir(folder) if name.endswith((".json", ".pkl")))

        self.assertEqual(names(own), names(whole))
        manifest = pathlib.Path(own, "manifest.jsonl").read_text().splitlines()
        done = [json.loads(line) for line in manifest]
        scenes = [line["scene"] for line in done if "scene" in line]
        self.assertEqual(len(scenes), len(set(scenes)))
        self.assertEqual(len(scenes), 14)

    def test_in_this_process(self):
        self.job(*self.words("local"))
        self.same_as_the_command("local")
        # A second run finds everything done.
        def written():
            return {path.name: path.stat().st_mtime_ns for path in pathlib.Path(self.folder, "local").glob("*-lambda*")}

        before = written()
        self.job(*self.words("local"))
        self.assertEqual(written(), before)

    def test_wrong_usage(self):
        self.assertIn("--out", self.job("generate", str(self.scenes), code=2).stderr)
        self.assertIn("--cores", self.job("generate", "--cores", "0", code=2).stderr)
        for wrong in ["--lambda=x", "--latest-start=9", "--format=x", "--avoidable={", "--rate=0", "--shard=3/2", "--options=1"]:
            name = wrong.split("=")[0]
            self.assertIn(name, self.job(*self.words("bad"), wrong, code=2).stderr)
        self.job(*self.words("bad"), "--aggression", "1", code=2)

    def test_options_are_those_of_the_command(self):
        own = set(re.findall(r"--[a-z][a-z-]*", self.job("--help").stdout)) - {"--engine", "--shards", "--cores", "--retries", "--join"}
        of_command = set(re.findall(r"^ +(?:-h, )?(--[a-z-]+)", command("generate", "--help-all"), re.MULTILINE)) - {"--help-all"}
        self.assertEqual(own, of_command)
        self.job(*self.words("bad"), "--method", "x", code=1)

    def test_a_shard_that_is_killed_and_run_again(self):
        words = self.words("killed")
        started = time.monotonic()
        self.job(*words, "--shard", "1/2")
        took = time.monotonic() - started
        shard = subprocess.Popen([*JOBS, *words, "--shard", "2/2"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        time.sleep(random.uniform(0.2, 0.9) * took)
        shard.send_signal(signal.SIGKILL)
        shard.wait()
        joined = subprocess.run([*JOBS, *words, "--join"], capture_output=True, text=True)
        if joined.returncode:
            # What is missing is named. It may have been killed after its last file.
            self.assertIn("shards 2 of 2", joined.stderr)
        self.job(*words, "--shard", "2/2")
        self.job(*words, "--join")
        self.same_as_the_command("killed")

    def test_shards_of_a_list(self):
        parts = [sage.load_folder(self.scenes, shard=(k, 3)).paths for k in (1, 2, 3)]
        self.assertEqual(sorted(sum(parts, [])), sorted(sage.load_folder(self.scenes).paths))
        self.assertTrue(all(parts))

    @needs("ray", "a job of Ray")
    def test_ray(self):
        for engine in ("ray", "ray-data"):
            with self.subTest(engine=engine):
                self.job(*self.words(engine), "--engine", engine, "--shards", "3", "--cores", "1")
                self.same_as_the_command(engine)
        # A folder that Ray began is finished without it.
        words = self.words("ray")
        for path in list(pathlib.Path(self.folder, "ray").glob("*-lambda1.00.json"))[:3]:
            path.unlink()
        self.job(*words)
        self.same_as_the_command("ray")


def attacked(paths, reports=None):
    """Paths and digests of attacks. Reports the process that makes them, and then takes its time."""
    if reports:
        pathlib.Path(reports, str(os.getpid())).touch()
        time.sleep(0.2)
    return list(zip(paths, digests_of(paths, 1.0)))


class Attacker:
    """An actor of Ray Data."""

    def __init__(self, reports):
        self.reports = reports

    def __call__(self, batch):
        found = attacked([str(path) for path in batch["item"]], self.reports)
        return {"path": [path for path, _ in found], "digest": [digest for _, digest in found]}


class Killer(threading.Thread):
    """Kills the first process that reports."""

    def __init__(self, reports):
        super().__init__(daemon=True)
        self.reports = reports
        self.killed = None

    def run(self):
        while not os.listdir(self.reports):
            time.sleep(0.01)
        self.killed = int(sorted(os.listdir(self.reports))[0])
        time.sleep(0.05)
        os.kill(self.killed, signal.SIGKILL)


class Faults(InFolder):
    """Of two workers one is killed during 180 attacks."""

    def setUp(self):
        super().setUp()
        self.paths = []
        for scene in procedural(60):
            self.paths.append(os.path.join(self.folder, f"{scene.id}.pkl"))
            scene.save(self.paths[-1])
        self.expected = dict(zip(self.paths, digests_of(self.paths, 1.0)))

    def batches(self):
        work = self.paths * 3
        return [work[k : k + 6] for k in range(0, len(work), 6)]

    def killer(self, name):
        """A folder for reports, and a killer that waits for the first."""
        reports = os.path.join(self.folder, name)
        os.mkdir(reports)
        killer = Killer(reports)
        killer.start()
        return reports, killer

    @needs("ray", "the fault test")
    def test_tasks(self):
        import ray

        from ray_support import ray_cluster

        with ray_cluster():
            for retries in (3, 0):
                reports, killer = self.killer(f"reports-{retries}")
                task = ray.remote(num_cpus=1, max_retries=retries)(attacked)
                tasks = [task.remote(batch, reports) for batch in self.batches()]
                if retries == 0:
                    with self.assertRaises(ray.exceptions.WorkerCrashedError):
                        ray.get(tasks)
                else:
                    found = [pair for batch in ray.get(tasks) for pair in batch]
                    self.assertEqual([path for path, _ in found], self.paths * 3)
                    self.assertTrue(all(digest == self.expected[path] for path, digest in found))
                self.assertIsNotNone(killer.killed)

    @needs("ray", "the fault test")
    def test_data(self):
        import ray

        from ray_support import ray_cluster

        with ray_cluster():
            reports, killer = self.killer("reports")
            data = ray.data.from_items(self.paths * 3, override_num_blocks=30)
            compute = ray.data.ActorPoolStrategy(size=2)
            found = data.map_batches(Attacker, fn_constructor_args=(reports,), batch_size=6, compute=compute, num_cpus=1)
            found = [(row["path"], row["digest"]) for row in found.take_all()]
            self.assertIsNotNone(killer.killed)
            self.assertGreater(len(os.listdir(reports)), 2)
            self.assertEqual(sorted(path for path, _ in found), sorted(self.paths * 3))
            self.assertTrue(all(digest == self.expected[path] for path, digest in found))


if __name__ == "__main__":
    unittest.main()

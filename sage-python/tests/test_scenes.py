"""Scenes, attacks and scores as values of Python."""

import copy
import gc
import json
import os
import pathlib
import pickle
import resource
import unittest

import numpy as np

import advsage as sage
from support import COMMAND, InFolder, command, procedural, scene_files


class Scenes(InFolder):
    def setUp(self):
        super().setUp()
        self.scene = sage.make("four-way", 1, 0)

    def test_arrays(self):
        scene = self.scene
        tracks, frames = len(scene.track_ids), scene.frames
        shapes = {"positions": (3,), "headings": (), "velocities": (2,), "sizes": (3,), "valid": ()}
        for name, shape in shapes.items():
            array = getattr(scene, name)
            self.assertEqual(array.shape, (tracks, frames, *shape))
            self.assertFalse(array.flags.writeable)
            with self.assertRaises(ValueError):
                array.flags.writeable = True
            self.assertIs(getattr(scene, name), array)
        self.assertEqual(scene.valid.dtype, bool)
        self.assertTrue(scene.valid[scene.ego].all())
        self.assertEqual(len(scene.kinds), tracks)
        moved = np.diff(scene.positions[scene.ego, :, :2], axis=0) / 0.1
        self.assertLess(np.abs(moved - scene.velocities[scene.ego, 1:]).max(), 2.0)
        features = scene.map_features
        self.assertEqual(sum(len(feature["points"]) for feature in features), len(scene.map_points))
        lanes = {feature["id"]: feature for feature in features if "exits" in feature}
        for lane in lanes.values():
            self.assertTrue(all(lane["id"] in lanes[other]["entries"] for other in lane["exits"]))
        for light in scene.lights:
            self.assertEqual(len(light["states"]), frames)

    def test_people_are_placed_and_searched(self):
        scenes = procedural(8)
        found = sage.search(scenes, "idm", budget=8, adversary_type="pedestrian", place={"beyond": 1.0})
        self.assertGreater(len(found), 3)
        for failure in found:
            self.assertIn("PEDESTRIAN", failure.scene.kinds[failure.scene.adversary])
            self.assertTrue(failure.row["clauses"]["human-time"])
            self.assertGreaterEqual(failure.row["person"]["seen"], 1.0)
        # The same person by hand, in a file that says so.
        placed = found[0].scene
        path = os.path.join(self.folder, "placed.pkl")
        placed.save(path)
        again = sage.load(path)
        self.assertEqual(again.track_ids[again.adversary], placed.track_ids[placed.adversary])
        attack = sage.Generator(method="person", feasibility="person")(placed)
        self.assertEqual(attack.trajectory.shape, (80, 2))
        for call, error in (
            (lambda: sage.search(scenes, "idm", adversary_type="horse"), sage.UnknownName),
            (lambda: sage.search(scenes, "idm", adversary_type="pedestrian", weights="waymo"), sage.SageError),
            (lambda: placed.with_person("cyclist", place={"beyond": -1}), sage.OptionError),
        ):
            with self.assertRaises(error):
                call()

    def test_rates_are_those_of_the_command(self):
        folder = os.path.join(self.folder, "scenes")
        command("scenes", "--count", "4", "--format", "pickle", "--out", folder)
        out = os.path.join(self.folder, "rates")
        command("rate", folder, "--ego", "idm", "--budget", "24", "--out", out)
        rated = sage.rate(folder, "idm", budget=24)
        self.assertEqual((len(rated), rated.errors), (4, {}))
        for row in rated:
            with open(os.path.join(out, f"{row['scene']}-idm.json")) as file:
                written = json.load(file)
            self.assertEqual({name: written[name] for name in row}, row)
            self.assertEqual(row["drives"], sum(goal["outcome"] is not None for goal in row["goals"]))
            for rates in row["rates"].values():
                for rate in rates.values():
                    self.assertLessEqual(rate["low"], rate["high"])
        self.assertTrue(0.0 <= rated.mean("contact", "feasible") <= 1.5)
        exact = sage.rate(folder, "replay", budget=None, events=["contact"])
        self.assertEqual(exact.mean("contact"), 0.0)
        for call, error in (
            (lambda: sage.rate(folder, budget=0), sage.OptionError),
            (lambda: sage.rate(folder, events=["horse"]), sage.OptionError),
            (lambda: sage.rate(folder, temperature=0.0), sage.OptionError),
        ):
            with self.assertRaises(error):
                call()

    def test_files_of_every_format(self):
        attacked = sage.Generator()(self.scene).scene
        for scene in (self.scene, attacked):
            for ending in ("pkl", "safetensors", "tfrecord", "xosc"):
                path = os.path.join(self.folder, f"a.{ending}")
                written = sage.convert(scene, path)
                self.assertTrue(all(os.path.getsize(file) for file in written))
                if ending == "xosc":
                    continue
                again = sage.load(path + ("#0" if ending == "tfrecord" else ""))
                self.assertEqual(again.track_ids[again.ego], scene.track_ids[scene.ego])
                self.assertTrue(np.array_equal(again.valid, scene.valid))
                where = again.valid[..., None]
                self.assertLess(np.abs(np.where(where, again.positions - scene.positions, 0.0)).max(), 1e-3)
        self.assertFalse(np.array_equal(attacked.positions, self.scene.positions))

    def test_copies_and_pickles(self):
        generator = sage.Generator(lambda_=0.5, options={"candidates": 16})
        attack = generator(self.scene, ego="idm", seed=3)
        episode = sage.simulate(self.scene, "idm", attack)
        for value in (self.scene, generator, attack, attack.scene, episode, sage.simulate(self.scene, "idm")):
            self.assertIsInstance(repr(value), str)
            for again in (copy.copy(value), copy.deepcopy(value), pickle.loads(pickle.dumps(value))):
                self.assertEqual(repr(again), repr(value))
        again = pickle.loads(pickle.dumps(episode))
        for name in ("row", "verdict", "end", "completion", "contacts", "attack"):
            self.assertEqual(getattr(again, name), getattr(episode, name), name)
        for name in ("trajectory", "trajectory_before", "plan"):
            self.assertTrue(np.array_equal(getattr(again, name), getattr(episode, name)), name)
        self.assertEqual(again.html(), episode.html())
        again = pickle.loads(pickle.dumps(attack))
        for name in ("trajectory", "candidates", "log_probs", "goals"):
            self.assertTrue(np.array_equal(getattr(again, name), getattr(attack, name), equal_nan=True), name)
        self.assertEqual((again.scores, again.candidate_scores), (attack.scores, attack.candidate_scores))
        self.assertTrue(np.array_equal(again.scene.positions, attack.scene.positions))
        scene = pickle.loads(pickle.dumps(self.scene))
        self.assertTrue(np.array_equal(generator(scene, seed=3).candidates, generator(self.scene, seed=3).candidates))

    def test_generators_that_query_the_driver_count_its_drives(self):
        generator = sage.Generator(method="goose")
        self.assertIn("queries the driver", generator.knows)
        attack = generator(self.scene, ego="idm")
        self.assertEqual(attack.queries, len(attack.candidates))
        self.assertEqual(pickle.loads(pickle.dumps(attack)).queries, attack.queries)
        # A recording does the same against every plan.
        self.assertEqual(generator(self.scene).queries, 0)
        episode = sage.simulate(self.scene, "idm", generator)
        self.assertEqual(episode.attack["queries"], attack.queries)
        self.assertTrue(np.array_equal(episode.plan, attack.trajectory))

    def test_recorded_scenes_keep_their_bits(self):
        generator = sage.Generator()
        for path in scene_files(10, self.folder):
            scene = sage.load(path)
            lean = sage.load(path, keep_source=False)
            again = pickle.loads(pickle.dumps(scene))
            for other in (lean, again):
                self.assertTrue(np.array_equal(other.positions, scene.positions))
                self.assertTrue(np.array_equal(generator(other).candidates, generator(scene).candidates))

    def test_roles(self):
        others = [id for id, kind in zip(self.scene.track_ids, self.scene.kinds) if kind == "VEHICLE"]
        ego, adversary = self.scene.track_ids[self.scene.ego], self.scene.track_ids[self.scene.adversary]
        other = next(id for id in others if id not in (ego, adversary))
        scene = self.scene.with_roles(adversary=other)
        self.assertEqual(scene.track_ids[scene.adversary], other)
        swapped = self.scene.with_roles(ego=adversary, adversary=ego)
        self.scene.save(os.path.join(self.folder, "source.pkl"))
        loaded = sage.load(os.path.join(self.folder, "source.pkl"))
        for changed in (scene, swapped, loaded.with_roles(adversary=other), loaded.with_roles(ego=adversary, adversary=ego)):
            for attacked in (changed, sage.Generator()(changed).scene):
                for ending in ("safetensors", "pkl", "tfrecord"):
                    path = os.path.join(self.folder, f"a.{ending}")
                    sage.convert(attacked, path)
                    again = sage.load(path + ("#0" if ending == "tfrecord" else ""))
                    roles = [again.track_ids[k] for k in (again.ego, again.adversary)]
                    self.assertEqual(roles, [changed.track_ids[k] for k in (changed.ego, changed.adversary)], ending)

    def test_a_scene_is_not_written_over_what_it_was_read_from(self):
        path = os.path.join(self.folder, "own.pkl")
        procedural(1)[0].save(path)
        scene, before = sage.load(path), pathlib.Path(path).read_bytes()
        for write in (scene.save, lambda path: sage.convert(scene, path)):
            with self.assertRaisesRegex(Exception, "what the scene was read from"):
                write(path)
        self.assertEqual(pathlib.Path(path).read_bytes(), before)
        scene.save(os.path.join(self.folder, "other.pkl"))

    def test_folders(self):
        for scene in procedural(5):
            scene.save(os.path.join(self.folder, f"{scene.id}.pkl"))
        scenes = sage.load_folder(self.folder)
        self.assertEqual((len(scenes), len(scenes.paths)), (5, 5))
        self.assertEqual([scene.path for scene in scenes], scenes.paths)
        self.assertEqual(scenes[-1].id, list(scenes)[-1].id)
        with self.assertRaises(IndexError):
            scenes[5]
        self.assertEqual(scenes[1:4].paths, scenes.paths[1:4])
        self.assertEqual(pickle.loads(pickle.dumps(scenes)).paths, scenes.paths)
        attacks = [attack.scene.name for attack in sage.generate_many(sage.Generator(), self.folder)]
        self.assertEqual(attacks, [scene.name for scene in scenes])

    def test_scores_are_those_of_the_command(self):
        attack = sage.Generator()(self.scene)
        path = os.path.join(self.folder, "scene.pkl")
        self.scene.save(path)
        scene = sage.load(path)
        rows = [{"name": str(k), "trajectory": plan.tolist()} for k, plan in enumerate(attack.candidates)]
        with open(os.path.join(self.folder, "candidates.json"), "w") as file:
            json.dump(rows, file)
        for convention in ("paper", "release"):
            printed = command(
                "score", path, "--candidates", os.path.join(self.folder, "candidates.json"), "--json",
                "--convention", convention, "--avoidable",
            )
            expected = [json.loads(line) for line in printed.splitlines()]
            for row in expected:
                del row["name"]
            own = sage.score(scene, attack.candidates, convention=convention, avoidable=True)
            self.assertEqual(own, expected)
        columns = sage.score_columns(scene, attack.candidates, convention="release")
        for name, column in columns.items():
            values = [row[name] if name in row else row["rewards"].get(name) for row in own]
            values = [np.nan if value is None else float(value) for value in values]
            self.assertTrue(np.array_equal(column, values, equal_nan=True), name)
        one = sage.score(scene, attack.trajectory)
        self.assertEqual(len(one), 1)
        path = scene.positions[scene.ego, 11:91, :2]
        self.assertEqual(sage.score(scene, attack.trajectory, ego=path)[0]["collision"], one[0]["collision"])

    def test_operating_points(self):
        names = {
            sage.Generator(lambda_=0.25).variant: "lambda0.25",
            sage.Generator(aggression=0.5).variant: "aggression0.50",
            sage.Generator(mix={"realistic": 0.5, "lawful": 0.5}).variant: "realistic0.50-lawful0.50-mu0.00",
            sage.Generator(lambda_=1.0, mu=0.5).variant: "lambda1.00-mu0.50",
        }
        for name, expected in names.items():
            self.assertEqual(name, expected)
        seeds = [sage.Generator(merger="dare")(self.scene, seed=seed).candidates for seed in (0, 1, 0)]
        self.assertTrue(np.array_equal(seeds[0], seeds[2]))

    def test_what_shows_itself(self):
        attack = sage.Generator()(self.scene)
        picture = sage.draw(self.scene, attack)
        self.assertTrue(picture._repr_svg_().startswith("<svg"))
        picture.save(os.path.join(self.folder, "a.svg"))
        episode = sage.simulate(self.scene, "idm", attack)
        self.assertIn("<html", episode.html())
        self.assertTrue(episode._repr_html_().startswith("<iframe"))
        row = sage.inspect(self.scene)
        self.assertEqual(row["capabilities"], {"attack": None, "drive": None, "road_edges": True, "traffic_lights": True})

    def test_failures(self):
        found = sage.search(procedural(4), "idm", budget=16, require="attack,believable")
        self.assertEqual(len(found.scenes), 4)
        self.assertEqual(len(found), sum(row["failures"] for row in found.scenes))
        self.assertTrue(all(failure.contact_after > 0 for failure in found))
        self.assertIn("4 scenes", repr(found))

    def test_an_evaluated_plan_is_what_the_search_found(self):
        require = "attack,believable"
        found = sage.search(procedural(8), "idm", budget=16, require=require)
        explained = [failure for failure in found if failure.sentence]
        # The mildest failure of each scene.
        self.assertEqual(len(explained), sum(row["failures"] > 0 for row in found.scenes))
        self.assertGreater(len(explained), 0)
        for failure in explained:
            evaluated = sage.evaluate(failure.scene, "idm", failure.trajectory, require=require)
            self.assertTrue(evaluated["failure"] and evaluated["reason"] is None)
            for field in ("contact", "clauses", "sentence", "explanation", "ego_path"):
                self.assertEqual(evaluated[field], failure.row[field], field)
            shrunk = failure.row["explanation"]["shrunk"]
            again = sage.evaluate(failure.scene, "idm", shrunk["trajectory"], require=require, explain=False)
            self.assertTrue(again["failure"])
            self.assertEqual((again["contact"], again["clauses"]), (shrunk["contact"], shrunk["clauses"]))
        scene = explained[0].scene
        passes = sage.evaluate(scene, "expert", explained[0].trajectory)
        self.assertEqual(passes["failure"], passes["reason"] is None)
        self.assertEqual(np.shape(passes["ego_path"])[1], 3)
        with self.assertRaises(sage.OptionError):
            sage.evaluate(scene, "idm", np.zeros((2, 80, 2)))

    def test_an_iterator_in_a_fork_is_refused(self):
        attacks = sage.generate_many(sage.Generator(), [self.scene] * 20, threads=2)
        next(attacks)
        child = os.fork()
        if child == 0:
            try:
                next(attacks)
            except sage.OptionError:
                os._exit(7)
            os._exit(0)
        self.assertEqual(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), 7)
        self.assertEqual(len(list(attacks)), 19)

    def test_names(self):
        names = sage.names()
        self.assertIn("sage", names["method"])
        for driver in names["ego"]:
            sage.simulate(self.scene, driver)
        for kind in names["kind"]:
            sage.make(kind)

    def test_memory_stays(self):
        """2000 loads with an attack; the resident size after the first tenth grows by at most 5 %."""
        count = int(os.environ.get("SAGE_LOADS", "300"))
        paths = scene_files(60, self.folder)
        generator = sage.Generator()

        def resident():
            gc.collect()
            with open("/proc/self/statm") as file:
                return int(file.read().split()[1]) * resource.getpagesize()

        if not pathlib.Path("/proc/self/statm").exists():
            self.skipTest("left out: the size of a process needs /proc")
        first = None
        for k in range(count):
            scene = sage.load(paths[k % len(paths)])
            generator(scene).scores
            if k == count // 10:
                first = resident()
        self.assertLess(resident() / first, 1.05 if count >= 2000 else 1.2)


if __name__ == "__main__":
    assert COMMAND.exists(), f"{COMMAND} is missing: cargo build --release"
    unittest.main()

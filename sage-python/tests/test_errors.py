"""Misuses raise the documented class, with a message that says what to do."""

import os
import pathlib
import subprocess
import sys
import unittest

import numpy as np

import advsage as sage
from support import InFolder


class Silent:
    """A planner without `act`."""


class Misuses(InFolder):
    """Each of these is an error that `except Exception` catches, of the documented class and of Python's own."""

    def check(self, own, pythons, said, call, *arguments, **keywords):
        with self.assertRaises(own) as caught:
            call(*arguments, **keywords)
        error = caught.exception
        self.assertIsInstance(error, sage.SageError)
        self.assertIsInstance(error, pythons)
        self.assertIsInstance(error, Exception)
        self.assertIn(said, str(error))
        return error

    def setUp(self):
        super().setUp()
        self.scene = sage.make("four-way", 1, 0)
        self.plan = sage.Generator()(self.scene).trajectory

    def test_a_missing_file(self):
        path = os.path.join(self.folder, "nothing.pkl")
        error = self.check(sage.MissingFile, FileNotFoundError, "nothing.pkl", sage.load, path)
        self.assertEqual((error.errno, error.filename), (2, path))

    def test_a_folder(self):
        self.check(sage.OptionError, ValueError, "load_folder", sage.load, self.folder)

    def test_a_folder_without_scenes(self):
        self.check(sage.FormatError, ValueError, ".pkl", sage.load_folder, self.folder)

    def test_a_file_without_permission(self):
        path = pathlib.Path(self.folder) / "secret.pkl"
        path.write_bytes(b"")
        path.chmod(0)
        if os.access(path, os.R_OK):
            self.skipTest("left out: this user reads every file")
        self.check(sage.FileError, OSError, "secret.pkl", sage.load, path)

    def test_a_pickle_that_is_a_program(self):
        path = pathlib.Path(self.folder) / "program.pkl"
        path.write_bytes(b"\x80\x04\x8c\x02os\x8c\x06system\x93\x8c\x04true\x85R.")
        self.check(sage.FormatError, ValueError, "os.system", sage.load, path)

    def test_a_file_that_is_no_scene(self):
        path = pathlib.Path(self.folder) / "text.pkl"
        path.write_text("no scene at all")
        self.check(sage.FormatError, ValueError, "text.pkl", sage.load, path)

    def test_hostile_files(self):
        folder = os.environ.get("SAGE_REFERENCE")
        files = sorted(pathlib.Path(folder).rglob("*.pkl")) if folder else []
        if not files:
            self.skipTest("left out: files of strangers need SAGE_REFERENCE")
        for file in files:
            with self.subTest(file=file.name):
                try:
                    sage.load(file)
                except sage.SageError as error:
                    self.assertIn(file.name, str(error))

    def test_a_track_that_there_is_not(self):
        self.check(sage.SceneError, ValueError, "`x`", self.scene.with_roles, adversary="x")

    def test_an_adversary_that_is_the_ego(self):
        ego = self.scene.track_ids[self.scene.ego]
        self.check(sage.SceneError, ValueError, "ego", self.scene.with_roles, adversary=ego)

    def test_an_unknown_method(self):
        self.check(sage.UnknownName, LookupError, "known: sage", sage.Generator, method="x")

    def test_unknown_weights(self):
        self.check(sage.UnknownName, LookupError, "procedural", sage.Generator, weights="x")

    def test_weights_that_are_none(self):
        path = pathlib.Path(self.folder) / "prior.safetensors"
        path.write_text("no weights")
        self.check(sage.FormatError, ValueError, "prior.safetensors", sage.Generator, weights=str(path))

    def test_an_unknown_selection(self):
        self.check(sage.UnknownName, LookupError, "natural", sage.Generator, selection="x")

    def test_an_unknown_merger(self):
        self.check(sage.UnknownName, LookupError, "linear", sage.Generator, merger="x")

    def test_an_unknown_option(self):
        self.check(sage.OptionError, ValueError, "candidates", sage.Generator, options={"candidate": 3})

    def test_an_option_of_no_kind(self):
        self.check(sage.OptionError, ValueError, "options", sage.Generator, options={"candidates": object()})

    def test_lambda_out_of_range(self):
        self.check(sage.OptionError, ValueError, "lambda is 1.5", sage.Generator, lambda_=1.5)

    def test_mu_out_of_range(self):
        self.check(sage.OptionError, ValueError, "mu is -1", sage.Generator, mu=-1.0)

    def test_aggression_out_of_range(self):
        self.check(sage.OptionError, ValueError, "aggression", sage.Generator, aggression=2.0)

    def test_two_operating_points(self):
        self.check(sage.OptionError, ValueError, "exclude", sage.Generator, lambda_=1.0, aggression=1.0)

    def test_an_unknown_convention(self):
        call = sage.score
        self.check(sage.UnknownName, LookupError, "release", call, self.scene, self.plan, convention="x")

    def test_a_wrong_shape(self):
        self.check(sage.OptionError, ValueError, "(n, 80, 2)", sage.score, self.scene, np.zeros((80, 3)))

    def test_79_steps(self):
        self.check(sage.OptionError, ValueError, "[79, 2]", sage.score, self.scene, self.plan[:79])

    def test_words_as_positions(self):
        for wrong in ([["a", "b"]], self.plan * 1j, np.ma.masked_array(self.plan), [[10**400, 0]] * 80):
            self.check(sage.OptionError, ValueError, "candidates", sage.score, self.scene, wrong)

    def test_nan(self):
        plan = self.plan.copy()
        plan[7, 1] = np.nan
        self.check(sage.OptionError, ValueError, "point 7", sage.score, self.scene, plan)

    def test_a_plan_far_away(self):
        self.check(sage.OptionError, ValueError, "point 0", sage.score, self.scene, self.plan + 1e4)

    def test_a_negative_seed(self):
        self.check(sage.OptionError, ValueError, "-1 is no seed", sage.Generator(), self.scene, seed=-1)
        self.check(sage.OptionError, ValueError, "no seed", sage.make, "merge", 2**64)
        self.check(sage.OptionError, ValueError, "-2 is no count", sage.generate_many, sage.Generator(), [], threads=-2)

    def test_a_planner_without_act(self):
        self.check(sage.OptionError, ValueError, "act(obs)", sage.simulate, self.scene, Silent())

    def test_an_unknown_driver(self):
        self.check(sage.UnknownName, LookupError, "idm", sage.simulate, self.scene, "x")

    def test_a_module_that_there_is_not(self):
        with self.assertRaises(ImportError):
            sage.simulate(self.scene, "py:no_such_module:Planner")
        self.check(sage.OptionError, ValueError, "py:package.module:Class", sage.simulate, self.scene, "py:os")
        self.check(sage.UnknownName, LookupError, "no `X`", sage.simulate, self.scene, "py:json:X")

    def test_an_unknown_kind(self):
        self.check(sage.UnknownName, LookupError, "four-way", sage.make, "x")

    def test_an_unknown_format(self):
        self.check(sage.OptionError, ValueError, ".xosc", sage.convert, self.scene, os.path.join(self.folder, "a.b"))
        path = os.path.join(self.folder, "a")
        self.check(sage.UnknownName, LookupError, "womd", sage.convert, self.scene, path, to="x")

    def test_a_folder_that_cannot_be_written(self):
        path = os.path.join(self.folder, "no", "folder", "a.pkl")
        self.check(sage.MissingFile, FileNotFoundError, "a.pkl", self.scene.save, path)

    def test_an_ending_that_says_nothing(self):
        self.check(sage.OptionError, ValueError, ".pkl", self.scene.save, os.path.join(self.folder, "a.txt"))

    def test_an_attack_on_another_scene(self):
        attack = sage.Generator()(sage.make("roundabout", 3))
        self.check(sage.OptionError, ValueError, "roundabout-3-0", sage.simulate, self.scene, "idm", attack)
        self.check(sage.OptionError, ValueError, "point 0", sage.simulate, self.scene, "idm", np.zeros((80, 2)))

    def test_a_class_in_place_of_a_planner(self):
        class Planner:
            def act(self, obs):
                return 0.0, 0.0

        self.check(sage.OptionError, ValueError, "give an instance: Planner()", sage.simulate, self.scene, Planner)

    def test_a_folder_that_there_is_not(self):
        for call in (sage.load_folder, lambda path: sage.stress("idm", path), lambda path: sage.search(path)):
            self.check(sage.MissingFile, FileNotFoundError, "nowhere", call, os.path.join(self.folder, "nowhere"))

    def test_a_shard_that_there_is_not(self):
        self.scene.save(os.path.join(self.folder, "a.pkl"))
        self.check(sage.OptionError, ValueError, "K/N", sage.load_folder, self.folder, shard=(3, 2))

    def test_no_thread(self):
        self.check(sage.OptionError, ValueError, "threads", sage.generate_many, sage.Generator(), [self.scene], threads=0)

    def test_something_else_than_scenes(self):
        attacks = sage.generate_many(sage.Generator(), [3])
        self.check(sage.OptionError, ValueError, "scenes", next, attacks)

    def test_an_unknown_requirement(self):
        self.check(sage.OptionError, ValueError, "believable", sage.search, [self.scene], "idm", require="x")

    def test_a_failing_scene_costs_no_other(self):
        paths = [os.path.join(self.folder, name) for name in ("a.pkl", "b.pkl", "c.pkl")]
        self.scene.save(paths[0])
        pathlib.Path(paths[1]).write_text("no scene")
        self.scene.save(paths[2])
        attacks = sage.generate_many(sage.Generator(), paths, threads=2)
        first = next(attacks)
        self.check(sage.FormatError, ValueError, "b.pkl", next, attacks)
        self.assertTrue(np.array_equal(next(attacks).trajectory, first.trajectory))
        self.assertEqual(list(attacks), [])
        scenes = iter(sage.load_folder(self.folder))
        first = next(scenes)
        self.check(sage.FormatError, ValueError, "b.pkl", next, scenes)
        self.assertEqual([scene.id for scene in scenes], [first.id])

    def test_nothing_is_printed(self):
        script = """
import advsage as sage
for call in (lambda: sage.load("nothing.pkl"), lambda: sage.Generator(weights="x"), lambda: sage._advsage._panic()):
    try:
        call()
    except Exception as error:
        print(type(error).__name__)
"""
        done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
        self.assertEqual(done.stdout.split(), ["MissingFile", "UnknownName", "InternalError"])
        self.assertEqual(done.stderr, "")


if __name__ == "__main__":
    unittest.main()

"""The blocks of `docs/python.md`, one after the other, and the examples."""

import ast
import contextlib
import importlib.util
import inspect
import io
import json
import os
import pathlib
import re
import shutil
import subprocess
import sys
import unittest

import advsage as sage
from support import COMMAND, REPOSITORY, InFolder, needs, procedural

EXAMPLES = REPOSITORY / "examples" / "python"


def signature(value):
    try:
        return str(inspect.signature(value)).replace("($self, ", "(").replace("($self)", "()")
    except (TypeError, ValueError):
        return ""


def reference():
    """All names of the module with their signatures and docstrings, as a page."""
    lines = ["# Python", "", "All names of `advsage`, with keywords and defaults. How they are used is on the [page of Python](../python.md).", ""]
    lines += ["<!-- Made by `SAGE_UPDATE=1 sage-python/check`. -->", ""]
    for name in sorted(sage.__all__):
        value = getattr(sage, name)
        if not callable(value):
            continue
        lines += [f"## {name}", "", f"`{name}{signature(value)}`", "", inspect.getdoc(value) or "", ""]
        if not isinstance(value, type) or issubclass(value, BaseException):
            continue
        for member, thing in sorted(vars(value).items()):
            if not member.startswith("_"):
                call = signature(thing) if callable(thing) else ""
                first = (inspect.getdoc(thing) or "").split("\n\n")[0].replace("\n", " ")
                lines += [f"- `{member}{call}`: {first}"]
        lines += [""]
    return "\n".join(lines).rstrip() + "\n"


class Documents(InFolder):
    def setUp(self):
        super().setUp()
        before = os.getcwd()
        os.chdir(self.folder)
        self.addCleanup(os.chdir, before)

    def test_the_page(self):
        text = (REPOSITORY / "docs" / "python.md").read_text()
        blocks = re.findall(r"```python(?: (\w+))?\n(.*?)```", text, re.DOTALL)
        self.assertGreater(len(blocks), 8)
        names = {"__name__": "page"}
        for number, (extra, block) in enumerate(blocks):
            if extra and importlib.util.find_spec(extra) is None:
                print(f"left out: block {number} of the page needs {extra}")
                continue
            with self.subTest(block=number), contextlib.redirect_stdout(io.StringIO()) as printed:
                exec(compile(block, f"block {number}", "exec"), names)
            # What the page shows as printed is what is printed.
            for shown in re.findall(r"print\(.*\) +# (<.*>)$", block, re.MULTILINE):
                self.assertIn(shown, printed.getvalue())

    def test_the_reference(self):
        page = REPOSITORY / "docs" / "reference" / "python.md"
        text = reference()
        if os.environ.get("SAGE_UPDATE"):
            page.parent.mkdir(exist_ok=True)
            page.write_text(text)
        self.assertTrue(page.exists() and page.read_text() == text, f"out of date: {page}; SAGE_UPDATE=1 writes it")

    def test_every_name_has_a_docstring(self):
        for name in sage.__all__:
            value = getattr(sage, name)
            self.assertTrue(value.__doc__, name)
            if isinstance(value, type):
                for member, thing in vars(value).items():
                    if not member.startswith("_") and (callable(thing) or hasattr(thing, "__get__")):
                        self.assertTrue(getattr(thing, "__doc__", None), f"{name}.{member}")

    def test_examples(self):
        for name in ("look", "score", "attack", "stress"):
            with self.subTest(example=name):
                done = subprocess.run([sys.executable, EXAMPLES / f"{name}.py"], capture_output=True, text=True)
                self.assertEqual((done.returncode, done.stderr), (0, ""))

    @needs("stable_baselines3", "the example of training")
    def test_the_example_of_training(self):
        os.mkdir("scenes")
        for scene in procedural(3):
            scene.save(f"scenes/{scene.id}.pkl")
        for name in ("train", "trained"):
            shutil.copy(EXAMPLES / f"{name}.py", ".")
        done = subprocess.run([sys.executable, "train.py", "scenes", "2048"], capture_output=True, text=True)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertRegex(done.stdout, r"attacked: route completion 0\.\d\d, contact in \d+% of 16 episodes")
        # What was trained drives for the command, and here.
        sys.path.insert(0, "")
        self.addCleanup(sys.path.remove, "")
        here = sage.simulate("scenes/four-way-7-0.pkl", "py:trained:Trained")
        environment = {**os.environ, "PATH": f"{pathlib.Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
        module = str(pathlib.Path(sage.__file__).parents[1])
        environment["PYTHONPATH"] = os.pathsep.join([module, *filter(None, [os.environ.get("PYTHONPATH")])])
        words = ["simulate", "scenes/four-way-7-0.pkl", "--ego", "py:trained:Trained", "--json", "--out", "drives"]
        done = subprocess.run([COMMAND, *words], capture_output=True, text=True, env=environment)
        self.assertEqual(done.returncode, 0, done.stderr)
        row = json.loads(done.stdout.splitlines()[0])
        self.assertEqual(row["ego"], "py:trained:Trained")
        self.assertEqual(row["completion"], here.completion)

    @needs("ray", "the example of Ray")
    def test_the_example_of_ray(self):
        done = subprocess.run([sys.executable, EXAMPLES / "ray_tasks.py"], capture_output=True, text=True)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn("of 8 hit the ego", done.stdout)

    @needs("mypy", "the check of types")
    def test_types(self):
        for command in (
            ["mypy", "--strict", *map(str, sorted(EXAMPLES.glob("*.py")))],
            ["mypy.stubtest", "advsage", "--ignore-missing-stub", "--allowlist", str(REPOSITORY / "sage-python/tests/stubtest_allowlist.txt")],
        ):
            done = subprocess.run([sys.executable, "-m", *command], capture_output=True, text=True)
            self.assertEqual(done.returncode, 0, done.stdout + done.stderr)


class Signatures(unittest.TestCase):
    """The keywords of a generator, as help, `_advsage.pyi` and calls have them."""

    GENERATOR = (
        "(*, method='sage', weights=None, lambda_=None, aggression=None, mix=None, mu=None, "
        "selection='natural', feasibility=None, merger='linear', options=None)"
    )

    def test_a_generator_has_its_keywords(self):
        self.assertEqual(str(inspect.signature(sage.Generator)), self.GENERATOR)

    def test_a_search_has_those_of_a_generator_and_takes_its_plans_by_default(self):
        of_generator = inspect.signature(sage.Generator).parameters
        for search in (sage.search, sage._advsage.search_each):
            of_search = inspect.signature(search).parameters
            for name, parameter in of_generator.items():
                default = None if name == "method" else parameter.default
                self.assertEqual((name, of_search[name].default), (name, default))

    def test_the_stub_has_the_same_defaults(self):
        stub = ast.parse((REPOSITORY / "sage-python/python/advsage/_advsage.pyi").read_text())
        generator = next(node for node in stub.body if isinstance(node, ast.ClassDef) and node.name == "Generator")
        new = next(node for node in generator.body if isinstance(node, ast.FunctionDef) and node.name == "__new__")
        stated = {a.arg: ast.literal_eval(d) for a, d in zip(new.args.kwonlyargs, new.args.kw_defaults)}
        real = {name: p.default for name, p in inspect.signature(sage.Generator).parameters.items()}
        self.assertEqual(stated, real)


if __name__ == "__main__":
    unittest.main()

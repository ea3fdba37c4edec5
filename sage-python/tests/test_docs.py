"""The blocks of `docs/python.md`, one after the other, and the examples."""

import contextlib
import io
import os
import re
import subprocess
import sys
import unittest

import advsage as sage
from support import REPOSITORY, InFolder, needs

EXAMPLES = REPOSITORY / "examples" / "python"


class Documents(InFolder):
    def setUp(self):
        super().setUp()
        before = os.getcwd()
        os.chdir(self.folder)
        self.addCleanup(os.chdir, before)

    def test_the_page(self):
        text = (REPOSITORY / "docs" / "python.md").read_text()
        blocks = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
        self.assertGreater(len(blocks), 8)
        names = {"__name__": "page"}
        for number, block in enumerate(blocks):
            with self.subTest(block=number), contextlib.redirect_stdout(io.StringIO()) as printed:
                exec(compile(block, f"block {number}", "exec"), names)
            # What the page shows as printed is what is printed.
            for shown in re.findall(r"print\(.*\) +# (<.*>)$", block, re.MULTILINE):
                self.assertIn(shown, printed.getvalue())

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


if __name__ == "__main__":
    unittest.main()

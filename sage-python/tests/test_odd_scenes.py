"""Scene files that are odd in many ways: no call panics, and a scene that cannot be used costs no other."""

import os
import pathlib
import subprocess
import unittest

import advsage as sage
from support import COMMAND, InFolder

#: Writes odd scenes; built with the tests of the workspace, beside the command.
WRITER = pathlib.Path(COMMAND).parent / "examples" / "write_odd_scenes"
COUNT = 600 if os.environ.get("SAGE_SLOW") == "1" else 60


class Odd(InFolder):
    def setUp(self):
        super().setUp()
        if not WRITER.exists():
            self.skipTest(f"left out: {WRITER} is not built")
        done = subprocess.run([WRITER, str(COUNT), self.folder], capture_output=True, text=True, check=True)
        self.odd = {os.path.basename(line.split(" ", 1)[0]): line for line in done.stdout.splitlines()}

    def check(self, errors):
        """No error is a defect of the package."""
        for name, error in errors.items():
            self.assertNotIsInstance(error, sage.InternalError, f"{name}: {error}")

    def test_every_scene_is_read_or_refused(self):
        read = 0
        for name, line in self.odd.items():
            try:
                scene = sage.load(os.path.join(self.folder, name))
            except sage.FormatError:
                continue
            read += 1
            self.assertEqual(scene.valid.shape, scene.headings.shape, line)
            scene.save(os.path.join(self.folder, "again.safetensors"))
            again = sage.load(os.path.join(self.folder, "again.safetensors"))
            self.assertEqual(scene.track_ids, again.track_ids, line)
        self.assertGreater(read, COUNT // 2)

    def test_stress_and_search_go_on(self):
        for planner in ("idm", Coasting()):
            result = sage.stress(planner, self.folder, sage.Generator(method="rule"))
            self.check(result.errors)
            self.assertEqual(len(result) + len(result.errors), COUNT)
        found = sage.search(self.folder, "idm", budget=3)
        self.check(found.errors)


class Coasting:
    def act(self, _obs):
        return 0.0, 0.0


if __name__ == "__main__":
    unittest.main()

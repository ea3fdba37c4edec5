"""What the tests share: scenes, the command, and tests that are left out, which say so."""

import os
import pathlib
import subprocess
import sys
import tempfile
import unittest

import advsage as sage

REPOSITORY = pathlib.Path(__file__).resolve().parents[2]
#: The command that the module is compared with.
COMMAND = pathlib.Path(os.environ.get("SAGE_COMMAND", REPOSITORY / "target" / "release" / "sage"))
#: Folder of recorded scenes; without it procedural ones are taken.
RECORDED = os.environ.get("SAGE_DATA")
KINDS = ["four-way", "merge", "straight", "t-junction", "curve", "roundabout", "divided"]

sys.path.insert(0, str(REPOSITORY / "examples" / "planners"))


def needs(module, why):
    """Leaves a test out, aloud, where a module is missing."""
    try:
        __import__(module)
    except ImportError:
        return unittest.skip(f"left out: {why} needs {module}")
    return lambda test: test


def procedural(count, seed=7):
    """Procedural scenes of all kinds."""
    return [sage.make(KINDS[k % len(KINDS)], seed, k // len(KINDS)) for k in range(count)]


def scene_files(count, folder):
    """Paths of scene files: recorded ones of `val` where there are some, else procedural ones that are written to a folder."""
    if RECORDED and (pathlib.Path(RECORDED) / "val").is_dir():
        return sage.load_folder(pathlib.Path(RECORDED) / "val").paths[:count]
    paths = []
    for scene in procedural(min(count, 14)):
        paths.append(os.path.join(folder, f"{scene.id}.pkl"))
        scene.save(paths[-1])
    return paths


def command(*words):
    """Runs `sage`."""
    done = subprocess.run([COMMAND, *map(str, words)], capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(done.stderr)
    return done.stdout


class InFolder(unittest.TestCase):
    """A test with a folder of its own."""

    def setUp(self):
        self._folder = tempfile.TemporaryDirectory()
        self.folder = self._folder.name
        self.addCleanup(self._folder.cleanup)

"""Results of many drives: searches and stress tests."""

from __future__ import annotations

import math
from collections.abc import Sequence

from . import _advsage
from .errors import FormatError, PlannerError, SceneError


class Failure:
    """A plan of the adversary that a driver fails at.

    `row` is what `sage search` records of it, a dictionary: `drive`, `plan`, `contact`, `clauses`, `reward`, `time_to_react`, ...
    """

    def __init__(self, scene, row):
        self.scene = scene
        self.row = row

    @property
    def trajectory(self):
        """The adversary's positions, metres: 80 pairs for frames 11 to 90; `simulate(scene, ego, trajectory)` drives against them."""
        return self.row["trajectory"]

    @property
    def contact_after(self):
        """Seconds from now to the contact."""
        return self.row["contact"]["step"] / 10.0

    def __repr__(self):
        return f"<Failure of '{self.row['ego']}' in '{self.scene.name}': contact after {self.contact_after:.1f} s>"


class Failures(Sequence):
    """What a search found: a sequence of `Failure`, and `scenes`, a dictionary for each scene that was searched."""

    def __init__(self, failures, scenes, errors):
        self._failures = failures
        #: Why scenes could not be searched, by name: a text that begins with the class of the exception.
        self.errors = errors
        #: For each scene what `sage search` records of it: `scene`, `drives`, `failures`, `reason`, ...
        self.scenes = scenes

    def __len__(self):
        return len(self._failures)

    def __getitem__(self, number):
        return self._failures[number]

    def to_pandas(self):
        """A frame with a row for each failure; needs pandas."""
        import pandas

        def row(failure):
            plan, contact = failure.row["plan"], failure.row["contact"]
            return {
                "scene": failure.scene.name,
                "ego": failure.row["ego"],
                "adversary": failure.row["adversary"],
                "drive": failure.row["drive"],
                "method": plan["method"],
                "lambda": plan["lambda"],
                "contact_after": failure.contact_after,
                "impact_speed": contact["impact_speed"],
                "overlap": contact["overlap"],
                "class": contact["class"],
                "reward": failure.row["reward"],
                "time_to_react": failure.row.get("time_to_react"),
            }

        return pandas.DataFrame([row(failure) for failure in self])

    def __repr__(self):
        failing = sum(row["failures"] > 0 for row in self.scenes)
        return f"<Failures: {len(self)} in {failing} of {len(self.scenes)} scenes>"


def search(scenes, ego="idm", **options):
    names = []
    failures, rows, errors = [], [], {}
    searched = _advsage.search_each(_named(scenes, names), ego, **options)
    for result in _each(searched, names, errors):
        scene, row, found = result
        rows.append(row)
        failures += [Failure(scene, failure) for failure in found]
    return Failures(failures, rows, errors)


class Stress(Sequence):
    """A driver under attack in many scenes: a sequence of `Episode`, `errors` by scene, and the rates of `table()`."""

    def __init__(self, ego, episodes, errors):
        self.ego = ego
        self._episodes = episodes
        #: Why scenes have no result, by name: a text that begins with the class of the exception.
        self.errors = errors

    def __len__(self):
        return len(self._episodes)

    def __getitem__(self, number):
        return self._episodes[number]

    @property
    def attacked(self):
        """Number of scenes in which the attack works."""
        return sum(episode.verdict["attack"] for episode in self)

    @property
    def at_fault(self):
        """Number of scenes in which it works and the driver is at fault."""
        return sum(episode.verdict["at_fault"] for episode in self)

    def table(self):
        """The rates with 95 % intervals (Wilson), as text."""
        lines = [f"{self.ego}: {len(self)} scenes"]
        for name, count in [("attacked", self.attacked), ("attacked, driver at fault", self.at_fault)]:
            low, high = wilson(count, len(self))
            share = 100.0 * count / len(self) if len(self) else math.nan
            lines.append(f"  {name}: {count} ({share:.0f} %, 95 % interval {100 * low:.0f} to {100 * high:.0f} %)")
        lines += [f"  no result in '{name}': {error}" for name, error in self.errors.items()]
        return "\n".join(lines)

    def __repr__(self):
        errors = f", {len(self.errors)} without a result" if self.errors else ""
        return f"<Stress of '{self.ego}': attacked in {self.attacked} of {len(self)} scenes{errors}>"


def stress(planner, scenes, attack=None, *, seed=0, threads=None, batch=32):
    generator = _advsage.Generator() if attack is None else attack
    names, errors = [], {}
    drives = _advsage.simulate_many(
        _named(scenes, names), planner, generator, seed=seed, threads=threads, batch=batch
    )
    episodes = list(_each(drives, names, errors))
    name = planner if isinstance(planner, str) else getattr(planner, "name", type(planner).__name__)
    return Stress(name, episodes, errors)


def wilson(count, total, z=1.959963984540054):
    """Interval of a share."""
    if total == 0:
        return 0.0, 1.0
    share, square = count / total, z * z / total
    middle = (share + square / 2) / (1 + square)
    half = z / (1 + square) * math.sqrt(share * (1 - share) / total + square / (4 * total))
    return max(middle - half, 0.0), min(middle + half, 1.0)


def _named(scenes, names):
    """The scenes of a folder, a file, one scene, or a list, one after another. Notes their names."""
    if isinstance(scenes, _advsage.Scene):
        scenes = [scenes]
    elif isinstance(scenes, str) or hasattr(scenes, "__fspath__"):
        # Paths, so that each is read where it is worked on, and one that is no scene costs no other.
        scenes = _advsage.load_folder(scenes).paths
    elif isinstance(scenes, _advsage.Scenes):
        scenes = scenes.paths
    for scene in scenes:
        names.append(scene.name if isinstance(scene, _advsage.Scene) else str(scene))
        yield scene


def _each(results, names, errors):
    """The results, in the order of the scenes. Notes why others have none, and goes on."""
    number = 0
    while True:
        try:
            yield next(results)
        except StopIteration:
            return
        except (FormatError, PlannerError, SceneError) as error:
            raised = error.__cause__ or error
            errors[names[number]] = f"{type(raised).__name__}: {raised}"
        number += 1

"""Results of many drives: searches, rates and stress tests."""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, TypeVar, overload

from . import _advsage
from .errors import FileError, FormatError, InternalError, PlannerError, SceneError
from .planner import Planner

SceneLike = _advsage.Scene | str | os.PathLike[str]
Result = TypeVar("Result")
#: Exceptions by name of the scene.
Errors = dict[str, Exception]


def _pandas() -> Any:
    try:
        import pandas  # type: ignore[import-untyped,unused-ignore]
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError("to_pandas() needs pandas: pip install pandas; the results are still here, and `row` of each holds the same values") from error
    return pandas


class Failure:
    """A plan of the adversary that a driver fails at.

    `row` is what `sage search` records of it, a dictionary: `drive`, `plan`, `contact`, `clauses`, `reward`, `latest_start`, ...
    """

    def __init__(self, scene: _advsage.Scene, row: dict[str, Any]) -> None:
        self.scene = scene
        self.row = row

    @property
    def trajectory(self) -> list[list[float]]:
        """The adversary's positions, metres: 80 pairs for frames 11 to 90; `simulate(scene, ego, trajectory)` drives against them."""
        trajectory: list[list[float]] = self.row["trajectory"]
        return trajectory

    @property
    def sentence(self) -> str | None:
        """What explains the failure, in words, if it was explained; `row["explanation"]` has the numbers."""
        return self.row.get("sentence")

    @property
    def contact_after(self) -> float:
        """Seconds from now to the contact."""
        return float(self.row["contact"]["step"]) / 10.0

    def __repr__(self) -> str:
        return f"<Failure of '{self.row['ego']}' in '{self.scene.name}': contact after {self.contact_after:.1f} s>"


class Failures(Sequence[Failure]):
    """What a search found: a sequence of `Failure`, `scenes`, a dictionary for each scene that was searched, and `errors`."""

    def __init__(self, failures: list[Failure], scenes: list[dict[str, Any]], errors: Errors) -> None:
        self._failures = failures
        #: For each scene what `sage search` records of it: `scene`, `drives`, `failures`, `reason`, ...
        self.scenes = scenes
        #: Why scenes could not be searched: exceptions by name of the scene.
        self.errors = errors

    def __len__(self) -> int:
        """Number of failures."""
        return len(self._failures)

    @overload
    def __getitem__(self, number: int) -> Failure: ...

    @overload
    def __getitem__(self, number: slice) -> Sequence[Failure]: ...

    def __getitem__(self, number: int | slice) -> Failure | Sequence[Failure]:
        return self._failures[number]

    def to_pandas(self) -> Any:
        """A frame with a row for each failure; needs pandas."""
        pandas = _pandas()

        def row(failure: Failure) -> dict[str, Any]:
            plan, contact, clauses = failure.row["plan"], failure.row["contact"], failure.row["clauses"]
            return {
                "scene": failure.scene.name,
                "ego": failure.row["ego"],
                "adversary": failure.row["adversary"],
                "drive": failure.row["drive"],
                "method": plan["method"],
                "lambda": None if plan["method"] == "random" else plan["lambda"],
                "contact_after": failure.contact_after,
                "impact_speed": contact["impact_speed"],
                "overlap": contact["overlap"],
                "class": contact["class"],
                "reward": failure.row["reward"],
                **clauses,
                "latest_start": failure.row.get("latest_start"),
                **(failure.row.get("circumstances") or {}),
            }

        return pandas.DataFrame([row(failure) for failure in self])

    def __repr__(self) -> str:
        failing = sum(row["failures"] > 0 for row in self.scenes)
        return f"<Failures: {len(self)} in {failing} of {len(self.scenes)} scenes{_without(self.errors)}>"


def search(
    scenes: SceneLike | Iterable[SceneLike],
    ego: str | Planner = "idm",
    *,
    budget: int = 64,
    require: str | None = None,
    references: Sequence[str] | None = None,
    first: bool = False,
    order: str = "surrogate",
    refine: float = 0.25,
    explain_failures: str = "mildest",
    plans: int = 256,
    method: str | None = None,
    options: dict[str, Any] | None = None,
    weights: str | None = None,
    lambda_: float | None = None,
    aggression: float | None = None,
    mix: dict[str, float] | None = None,
    mu: float | None = None,
    selection: str = "natural",
    feasibility: str | None = None,
    merger: str = "linear",
    adversary_type: str | None = None,
    place: dict[str, Any] | None = None,
    seed: int = 0,
    threads: int | None = None,
) -> Failures:
    """Searches scenes with the driver in the loop for plans of the adversary that it fails at.

    In each scene at most `budget` plans are driven against, of at most `plans` feasible ones that are proposed; what was driven
    decides which is next (`order`: "surrogate", "random", "pool"), and in the last `refine` of the budget plans are refined against
    what the driver did, until the first failure. A failure meets all clauses of `require`, of
    "attack,believable,at-fault,preventable" (all by default), "avoidable", "human-time", "human-time-r157", "strict", "holds" and "believable-1"; `references` names the drivers that
    are asked in place of r157, idm, pdm and expert whether they prevent a contact; `first` stops at the first one. `explain_failures`
    says which are explained, by some ten drives more: "mildest" (the one whose adversary is driven least differently from the
    recording), "all" or "none". Plans are those of several
    generators, or of one `method` with its `options`. The other options are those of `Generator`. A scene that cannot be
    read or searched is in `errors` of the result, with the exception.

    `adversary_type`, "pedestrian" or "cyclist", places a person beside the ego's recorded way, who attacks in place of a car
    (`place`: see `Scene.with_person`); a failure then asks for "human-time" too, and options of networks do not apply.
    """
    names: list[str] = []
    failures: list[Failure] = []
    rows: list[dict[str, Any]] = []
    errors: Errors = {}
    searched = _advsage.search_each(
        _named(_listed(scenes), names),
        ego,
        budget=budget,
        require=require,
        references=references and list(references),
        first=first,
        order=order,
        refine=refine,
        explain_failures=explain_failures,
        plans=plans,
        method=method,
        options=options,
        weights=weights,
        lambda_=lambda_,
        aggression=aggression,
        mix=mix,
        mu=mu,
        selection=selection,
        feasibility=feasibility,
        merger=merger,
        adversary_type=adversary_type,
        place=place,
        seed=seed,
        threads=threads,
    )
    for scene, row, found in _each(searched, names, errors):
        rows.append(row)
        failures += [Failure(scene, failure) for failure in found]
    return Failures(failures, rows, errors)


class Rates(Sequence[dict[str, Any]]):
    """How likely a driver fails: a sequence of what `sage rate` records of each scene, dictionaries, and `errors`.

    A row has `rates`, `mass` and `undriven` by condition ("clear-of-recorded-ego", "feasible"), `likeliest`, `goals`, ...
    """

    def __init__(self, rows: list[dict[str, Any]], errors: Errors) -> None:
        self._rows = rows
        #: Why scenes could not be rated: exceptions by name of the scene.
        self.errors = errors

    def __len__(self) -> int:
        """Number of scenes."""
        return len(self._rows)

    @overload
    def __getitem__(self, number: int) -> dict[str, Any]: ...

    @overload
    def __getitem__(self, number: slice) -> Sequence[dict[str, Any]]: ...

    def __getitem__(self, number: int | slice) -> dict[str, Any] | Sequence[dict[str, Any]]:
        return self._rows[number]

    def mean(self, event: str = "failure", given: str = "clear-of-recorded-ego") -> float:
        """Mean rate of an event over the scenes in which a plan meets the condition; `nan` without any."""
        rates = [row["rates"][given][event]["rate"] for row in self if row["rates"][given]]
        return sum(rates) / len(rates) if rates else math.nan

    def to_pandas(self) -> Any:
        """A frame with a row for each scene, condition and event; needs pandas."""
        pandas = _pandas()
        rows = [
            {"scene": row["scene"], "ego": row["ego"], "given": given, "event": event, **rate, "drives": row["drives"]}
            for row in self
            for given, rates in row["rates"].items()
            for event, rate in rates.items()
        ]
        return pandas.DataFrame(rows)

    def __repr__(self) -> str:
        return f"<Rates: failure {100.0 * self.mean():.2f} % in {_scenes(len(self))}{_without(self.errors)}>"


def rate(
    scenes: SceneLike | Iterable[SceneLike],
    ego: str | Planner = "idm",
    *,
    budget: int | None = 64,
    require: str | None = None,
    given: str = "clear-of-recorded-ego",
    events: Sequence[str] | None = None,
    weights: str | None = None,
    temperature: float | None = None,
    profiles: int | None = None,
    aware: bool = False,
    feasibility: str | None = None,
    references: Sequence[str] | None = None,
    seed: int = 0,
    threads: int | None = None,
) -> Rates:
    """How likely a driver fails in scenes, if the adversary moves as an untuned motion prior says.

    `budget` plans are driven against in each scene, likelier ones more often; `None` drives all, and the rates are exact. `events`
    are "contact", "failure" (by `require`, as for `search`) and names of clauses; `likeliest` is the likeliest failure under the
    condition `given`. The density is that of the prior of `weights`, at its own `temperature` if none is given, with `profiles` of a
    goal (5 if none is given); with `aware` the adversary looks out once, *now*. Rates are no accident rates: scenes are chosen. A
    scene that cannot be read or rated is in `errors` of the result.
    """
    names: list[str] = []
    rows: list[dict[str, Any]] = []
    errors: Errors = {}
    rated = _advsage.rate_each(
        _named(_listed(scenes), names),
        ego,
        budget=budget,
        require=require,
        given=given,
        events=events and list(events),
        weights=weights,
        temperature=temperature,
        profiles=profiles,
        aware=aware,
        feasibility=feasibility,
        references=references and list(references),
        seed=seed,
        threads=threads,
    )
    for _, row, _ in _each(rated, names, errors):
        rows.append(row)
    return Rates(rows, errors)


class Stress(Sequence[_advsage.Episode]):
    """A driver under attack in many scenes: a sequence of `Episode`, the shares of `table()`, and `errors`."""

    def __init__(self, ego: str, episodes: list[_advsage.Episode], errors: Errors) -> None:
        #: Name of the driver.
        self.ego = ego
        self._episodes = episodes
        #: Why scenes have no result: exceptions by name of the scene.
        self.errors = errors

    def __len__(self) -> int:
        """Number of scenes with a result."""
        return len(self._episodes)

    @overload
    def __getitem__(self, number: int) -> _advsage.Episode: ...

    @overload
    def __getitem__(self, number: slice) -> Sequence[_advsage.Episode]: ...

    def __getitem__(self, number: int | slice) -> _advsage.Episode | Sequence[_advsage.Episode]:
        return self._episodes[number]

    @property
    def attacked(self) -> int:
        """Number of scenes in which the attack works: the driver's first contact is with the adversary, and it has none without
        the attack."""
        return self._count("attack")

    @property
    def at_fault(self) -> int:
        """Number of scenes in which the attack works and nuPlan's rule gives the fault to the driver."""
        return self._count("at_fault")

    def _count(self, name: str) -> int:
        return sum(episode.verdict is not None and episode.verdict[name] for episode in self)

    def table(self) -> str:
        """The shares with 95 % intervals (Wilson), and what has no result, as text."""
        lines = [f"{self.ego}: {_scenes(len(self))}"]
        for name, count in [("attacked", self.attacked), ("attacked, driver at fault", self.at_fault)]:
            if len(self) == 0:
                lines.append(f"  {name}: –")
                continue
            low, high = wilson(count, len(self))
            share = 100.0 * count / len(self)
            lines.append(f"  {name}: {count} ({share:.0f} %, 95 % interval {100 * low:.0f} to {100 * high:.0f} %)")
        lines += [f"  no result in '{name}': {_words(error)}" for name, error in self.errors.items()]
        return "\n".join(lines)

    def to_pandas(self) -> Any:
        """A frame with a row for each scene; needs pandas."""
        pandas = _pandas()

        def row(episode: _advsage.Episode) -> dict[str, Any]:
            first = episode.contacts[0] if episode.end == "contact" else {}
            return {
                "scene": episode.scene.name,
                "ego": episode.ego,
                **(episode.verdict or {}),
                "end": episode.end,
                "steps": len(episode.trajectory) - 1,
                "completion": episode.completion,
                "contact_with": first.get("with"),
                "impact_speed": first.get("impact_speed"),
                "class": first.get("class"),
                "latest_start": (episode.attack or {}).get("latest_start"),
            }

        return pandas.DataFrame([row(episode) for episode in self])

    def __repr__(self) -> str:
        return f"<Stress of '{self.ego}': attacked in {self.attacked} of {_scenes(len(self))}{_without(self.errors)}>"


def stress(
    planner: str | Planner,
    scenes: SceneLike | Iterable[SceneLike],
    attack: _advsage.Generator | None = None,
    *,
    seed: int = 0,
    threads: int | None = None,
    batch: int = 32,
) -> Stress:
    """Attacks a driver in many scenes: in each it drives without an attack, the attack is planned against that drive, and it
    drives again.

    `scenes` is a folder, a scene, or a list of scenes and paths; `attack` a `Generator`, by default SAGE at λ = 1. A scene in which
    the planner fails, or that cannot be read or attacked, is in `errors` of the result, with the exception. `batch` is the number of
    scenes that a planner with `act_many` drives at once, `threads` that of other drivers than planners of Python.
    """
    names: list[str] = []
    errors: Errors = {}
    generator = _advsage.Generator() if attack is None else attack
    drives = _advsage.simulate_many(
        _named(_listed(scenes), names), planner, generator, seed=seed, threads=threads, batch=batch
    )
    episodes = list(_each(drives, names, errors))
    name = planner if isinstance(planner, str) else getattr(planner, "name", type(planner).__name__)
    return Stress(name, episodes, errors)


def wilson(count: int, total: int, z: float = 1.959963984540054) -> tuple[float, float]:
    """Interval of a share."""
    if total == 0:
        return 0.0, 1.0
    share, square = count / total, z * z / total
    middle = (share + square / 2) / (1 + square)
    half = z / (1 + square) * math.sqrt(share * (1 - share) / total + square / (4 * total))
    return max(middle - half, 0.0), min(middle + half, 1.0)


def _listed(scenes: SceneLike | Iterable[SceneLike]) -> Iterable[SceneLike]:
    """The scenes of a folder, a file, one scene, or a list. Those of a folder are paths, so that each is read where it is worked on,
    and one that is no scene costs no other."""
    if isinstance(scenes, _advsage.Scene):
        return [scenes]
    if isinstance(scenes, (str, os.PathLike)):
        return _advsage.load_folder(scenes).paths
    if isinstance(scenes, _advsage.Scenes):
        return scenes.paths
    return scenes


def _named(scenes: Iterable[SceneLike], names: list[str]) -> Iterator[SceneLike]:
    """The scenes, one after another. Notes their names, which are different."""
    counts: dict[str, int] = {}
    for scene in scenes:
        own = scene.name if isinstance(scene, _advsage.Scene) else os.path.splitext(os.path.basename(scene))[0]
        counts[own] = counts.get(own, 0) + 1
        names.append(own if counts[own] == 1 else f"{own} ({counts[own]})")
        yield scene


def _each(results: Iterator[Result], names: list[str], errors: Errors) -> Iterator[Result]:
    """The results, in the order of the scenes. Notes why others have none, and goes on; says so if there is none at all."""
    number = found = 0
    while True:
        try:
            result = next(results)
        except StopIteration:
            break
        except (FileError, FormatError, InternalError, PlannerError, SceneError) as error:
            # What a planner raised says more than that it failed.
            raised = error.__cause__ if isinstance(error.__cause__, Exception) else error
            errors[names[number]] = raised
        else:
            found += 1
            yield result
        number += 1
    if errors and not found:
        name, first = next(iter(errors.items()))
        text = f"none of {_scenes(number)} has a result; the first, '{name}': {_words(first)}"
        warnings.warn(text, RuntimeWarning, stacklevel=4)


def _words(error: Exception) -> str:
    return f"{type(error).__name__}: {error}"


def _scenes(count: int) -> str:
    return f"{count} scene" if count == 1 else f"{count} scenes"


def _without(errors: Errors) -> str:
    return f", {len(errors)} without a result" if errors else ""

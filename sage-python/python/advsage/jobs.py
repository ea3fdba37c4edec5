"""Large runs of `generate`: in this process, or shared out by Ray.

    python -m advsage.jobs generate scenes/ --lambda 1 --out attacked/
    python -m advsage.jobs generate scenes/ --lambda 1 --out attacked/ --engine ray --shards 64

Options are those of `sage generate`; file names, format and resumption are the command's own, so a folder that one engine began another
finishes. Ray hands out numbers of shards, never scenes, and workers need a file system that they share. Exit codes: 0 all is done, 2 wrong
usage, 65 done but scenes are bad, 74 an input or output error that another try may pass, 1 anything else.
"""

from __future__ import annotations

import argparse
import importlib
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from typing import Any

from . import _advsage

RETRY = 74
PARENT = "ADVSAGE_JOB_PARENT"  # the process that waits for a shard
WAIT = 10.0  # seconds until a shard is tried again: another process may still hold it


#: A shard, its exit code, and its messages.
Done = tuple[str, int, str]


class Retry(Exception):
    """A shard that another try may finish."""


def run_shard(words: list[str], shard: str, cores: int, folder: str) -> Done:
    """Runs a shard in a process of its own, from the folder where the job was started. Returns exit code and messages."""
    command = [sys.executable, "-m", "advsage.jobs", "generate", *words, "--threads", str(cores), "--shard", shard]
    environment = {**os.environ, PARENT: str(os.getpid())}
    done = subprocess.run(
        command, cwd=folder, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )
    if done.returncode < 0:
        # The system killed it, perhaps for its memory.
        raise Retry(f"the shard was ended by signal {-done.returncode}")
    if done.returncode == RETRY:
        time.sleep(WAIT)
        raise Retry(done.stderr)
    return shard, done.returncode, done.stderr


def _end_with(parent: int) -> None:
    """Ends this process when its parent does: a worker that was killed must not leave a shard that works on, which would hold it."""
    while os.getppid() == parent:
        time.sleep(0.2)
    os.kill(os.getpid(), signal.SIGTERM)


class _Actor:
    """An actor of Ray Data, for shards that a batch names."""

    def __init__(self, words: list[str], cores: int, folder: str) -> None:
        self.about = words, cores, folder

    def __call__(self, batch: dict[str, Any]) -> dict[str, Any]:
        words, cores, folder = self.about
        done = [run_shard(words, str(shard), cores, folder) for shard in batch["item"]]
        return {name: [row[k] for row in done] for k, name in enumerate(("shard", "code", "said"))}


def by_tasks(words: list[str], shards: list[str], cores: int, retries: int) -> Iterator[Done]:
    """Runs shards as tasks of Ray. Yields what came of each; of one that failed too often why."""
    ray = _ray()
    task = ray.remote(num_cpus=cores, max_retries=retries, retry_exceptions=[Retry])(run_shard)
    tasks = {task.remote(words, shard, cores, os.getcwd()): shard for shard in shards}
    waiting = list(tasks)
    while waiting:
        [ready], waiting = ray.wait(waiting)
        try:
            yield ray.get(ready)
        except ray.exceptions.RayError as error:
            yield tasks[ready], RETRY, str(error)


def by_data(words: list[str], shards: list[str], cores: int, retries: int) -> Iterator[Done]:
    """The same in a pool of actors of Ray Data, which starts actors anew that died."""
    ray = _ray()
    size = max(int(ray.cluster_resources().get("CPU", 1)) // cores, 1)
    data = ray.data.from_items(shards, override_num_blocks=len(shards))
    options = {"max_restarts": retries, "max_task_retries": retries}
    rows = data.map_batches(
        _Actor,
        fn_constructor_args=(words, cores, os.getcwd()),
        batch_size=1,
        compute=ray.data.ActorPoolStrategy(size=size),
        num_cpus=cores,
        **options,
    )
    missing = set(shards)
    try:
        for row in rows.iter_rows():
            missing.discard(row["shard"])
            yield row["shard"], row["code"], row["said"]
    except ray.exceptions.RayError as error:
        for shard in sorted(missing):
            yield shard, RETRY, str(error)


def _ray() -> Any:
    """Ray, which this package does not need otherwise."""
    try:
        return importlib.import_module("ray")
    except ImportError:
        raise SystemExit("this engine needs Ray: pip install 'ray[data]'") from None


ENGINES = {"ray": by_tasks, "ray-data": by_data}


def generate(
    words: list[str], engine: str = "local", shards: int | None = None, cores: int = 2, retries: int = 5
) -> int:
    """Runs `sage generate` with these words, in processes of its own, and returns its exit code."""
    if engine == "local":
        return subprocess.run([sys.executable, "-m", "advsage.jobs", "generate", *words]).returncode
    ray = _ray()
    if not ray.is_initialized():
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        ray.init(logging_level="error", include_dashboard=False)
    count = shards or max(4 * int(ray.cluster_resources().get("CPU", 1)) // cores, 1)
    names = [f"{k}/{count}" for k in range(1, count + 1)]
    worst = 0
    for shard, code, said in ENGINES[engine](words, names, cores, retries):
        if code:
            print(f"shard {shard}: exit code {code}\n{said}", file=sys.stderr)
            worst = max(worst, code)
    # In a process of its own: the join works as another run would.
    joined = subprocess.run([sys.executable, "-m", "advsage.jobs", "generate", *words, "--join"]).returncode
    return worst if worst not in (0, 65) else joined


def _of_engine() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    group = parser.add_argument_group("engine")
    group.add_argument("--engine", choices=["local", *ENGINES], default="local", help="who shares out the work (default: local)")
    group.add_argument("--shards", type=int, help="number of shards (default: four for each worker)")
    group.add_argument("--cores", type=int, default=2, help="cores of a shard (default: 2)")
    group.add_argument("--retries", type=int, default=5, help="tries after the first one of a shard whose worker died (default: 5)")
    return parser


def _of_generate(engine: argparse.ArgumentParser) -> argparse.ArgumentParser:
    """The options of `sage generate`, whose help says more of each."""
    parser = argparse.ArgumentParser(
        prog="python -m advsage.jobs",
        description=(__doc__ or "").split("\n\n")[0],
        epilog="docs/reference/commands.md describes the options.",
        parents=[engine],
        allow_abbrev=False,
    )
    parser.add_argument("command", choices=["generate"], help="attack scenes")
    parser.add_argument("scene", help="scene file, TFRecord file, record (FILE#3), or folder of them")
    add = parser.add_argument_group("attack").add_argument
    add("--method", default="sage", metavar="NAME", help="generator (default: sage)")
    add("--options", metavar="JSON", help="options of the generator")
    add("--lambda", metavar="L", help="interpolation weight: a number, a list, or FROM:TO:STEP (default: 1)")
    add("--aggression", metavar="A", help="aggression, which sets lambda and mu")
    add("--mix", metavar="NAME=W,...", help="weights of the experts by name")
    add("--mu", metavar="M", help="weight of the selection, 0 to 1 (default: lambda)")
    add("--merger", default="linear", metavar="NAME", help="merger of the experts (default: linear)")
    add("--weights", metavar="NAME", help="weights of the experts: a name or a folder (default: procedural)")
    add("--seed", default="0", metavar="S", help="seed of random numbers (default: 0)")
    add = parser.add_argument_group("selection").add_argument
    add("--selection", default="natural", metavar="NAME", help="objective that selects (default: natural)")
    add("--goal", metavar="X,Y", help="select the feasible plan that ends nearest to this place")
    add("--feasibility", metavar="NAME", help="feasibility rule in place of that of the selection")
    add("--latest-start", metavar="T", help="seconds before the contact at which an evasive manoeuvre must begin")
    add("--avoidable", nargs="?", const="{}", metavar="JSON", help="options of the search for evasive manoeuvres")
    add = parser.add_argument_group("driver").add_argument
    add("--ego", default="replay", metavar="POLICY", help="drives the ego before the attack (default: replay)")
    add("--ego-timeout", metavar="TIMES", help="seconds that a driver that is a program has to answer")
    add = parser.add_argument_group("scene").add_argument
    add("--adversary", metavar="ID", help="track of the adversary")
    add("--adversary-type", choices=["pedestrian", "cyclist"], help="attack with a person, placed beside the ego's way")
    add("--place", metavar="JSON", help="how the person is placed")
    add("--now", metavar="FRAME", help="frame that becomes now")
    add("--resample", action="store_true", help="also read recordings below 5 Hz")
    add("--rate", metavar="HZ", help="frames per second of a file without times")
    add("--trust", choices=["positions"], help="recompute values that contradict the positions")
    add("--ego-track", metavar="ID", help="road user that is the ego")
    add("--without", metavar="IDS", help="road users that are left out")
    add("--strict", action="store_true", help="refuse a scene with an unusable road user")
    add = parser.add_argument_group("output").add_argument
    add("--out", required=True, metavar="DIR", help="output folder")
    add("--format", default="pickle", metavar="NAME", help="scene files of attacks: pickle, native, both, rows, ... (default: pickle; another name lists all)")
    add("--standard", metavar="VERSION", help="version of OpenSCENARIO")
    add("--scenario-ego", metavar="WHO", help="who drives the ego of a scenario")
    printed = parser.add_mutually_exclusive_group()
    printed.add_argument("--json", action="store_true", help="print results as JSON")
    printed.add_argument("--quiet", action="store_true", help="print the table at the end alone")
    add("--no-pages", action="store_true", help="write no pages and no pictures")
    add("--no-candidates", action="store_true", help="leave candidates that were not selected out of the rows")
    add = parser.add_argument_group("run").add_argument
    add("--threads", metavar="N", help="number of threads (default: all cores)")
    part = parser.add_mutually_exclusive_group()
    part.add_argument("--force", action="store_true", help="write into a folder that is not empty")
    part.add_argument("--shard", metavar="K/N", help="attack the scenes of a shard alone")
    part.add_argument("--join", action="store_true", help="complete the folder from its shards; work on no scene")
    return parser


def main(words: list[str] | None = None) -> int:
    words = sys.argv[1:] if words is None else words
    engine = _of_engine()
    parser = _of_generate(engine)
    given = vars(parser.parse_args(words))
    own, others = engine.parse_known_args(words)
    others.remove("generate")
    for name, value, least in [("--shards", own.shards, 1), ("--cores", own.cores, 1), ("--retries", own.retries, 0)]:
        if value is not None and value < least:
            parser.error(f"{name} is {value}; expected at least {least}")
    if own.engine != "local":
        return generate(others, own.engine, own.shards, own.cores, own.retries)
    if os.environ.get(PARENT):
        parent = int(os.environ[PARENT])
        threading.Thread(target=_end_with, args=(parent,), daemon=True).start()
    # In this process, which does nothing else.
    options = {name: value for name, value in given.items() if value not in (None, False) and name not in vars(own)}
    return _advsage.run_generate(options, others)


if __name__ == "__main__":
    sys.exit(main())

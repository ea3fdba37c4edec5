"""Runs the shards of a sage command on a Ray cluster whose workers share a file system.

    python3 examples/ray_shards.py 64 sage generate scenes/ --out attacked/

Ray hands out shards alone; all files are the command's own. So another scheduler can finish the folder, and a task that
Ray runs twice changes nothing.
"""
import os
import subprocess
import sys
import time

import ray

CORES = int(os.environ.get("SAGE_CORES", "2"))  # of a shard
RETRY = 74  # exit status: an input or output error, or another process still holds the shard


class Retry(Exception):
    pass


@ray.remote(num_cpus=CORES, max_retries=5, retry_exceptions=[Retry])
def run(command, shard, folder):
    words = [*command, "--threads", str(CORES), "--shard", shard]
    done = subprocess.run(words, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    if done.returncode == RETRY:
        time.sleep(10)
        raise Retry(done.stderr)
    return done.returncode, done.stderr


def main(shards, *command):
    out = command[command.index("--out") + 1]
    ray.init(logging_level="error")
    tasks = {run.remote(command, f"{k}/{shards}", os.getcwd()): k for k in range(1, int(shards) + 1)}
    waiting = list(tasks)
    while waiting:
        [ready], waiting = ray.wait(waiting)
        try:
            code, said = ray.get(ready)
        except ray.exceptions.RayError as error:  # a shard that failed too often costs no other
            code, said = RETRY, str(error)
        if code:
            print(f"shard {tasks[ready]}/{shards}: exit status {code}\n{said}", file=sys.stderr)
    return subprocess.run([command[0], "join", out]).returncode


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))

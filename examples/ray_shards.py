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

RETRY = 74  # exit status: an input or output error, or another process still holds the shard


class Retry(Exception):
    pass


@ray.remote(max_retries=5, retry_exceptions=[Retry])
def run(command, shard, folder):
    words = [*command, "--shard", shard]
    done = subprocess.run(words, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    if done.returncode == RETRY:
        time.sleep(10)
        raise Retry(done.stderr)
    return shard, done.returncode, done.stderr


def main(shards, *command):
    ray.init(logging_level="error")
    numbers = range(1, int(shards) + 1)
    waiting = [run.remote(command, f"{number}/{shards}", os.getcwd()) for number in numbers]
    codes = set()
    while waiting:
        [ready], waiting = ray.wait(waiting)
        shard, code, said = ray.get(ready)
        codes.add(code)
        if code:
            print(f"shard {shard}: exit status {code}\n{said}", file=sys.stderr)
    out = command[command.index("--out") + 1]
    return subprocess.run([command[0], "join", out]).returncode or max(codes)


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))

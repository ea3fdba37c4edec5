"""A planner that misbehaves in the way that its argument names; without one it drives straight on."""

import json
import os
import signal
import subprocess
import sys
import time

how = sys.argv[1] if len(sys.argv) > 1 else ""
GOOD = {"steer": 0.0, "throttle": 0.1}
steps = 0


def say(text, end="\n"):
    sys.stdout.write(text + end)
    sys.stdout.flush()


def forever():
    while True:
        time.sleep(1)


def start():
    if how == "exits at its start":
        print("no model found", file=sys.stderr)
        sys.exit(3)
    if how == "writes too much to its log at its start":
        for _ in range(80):
            os.write(2, b"x" * (1 << 20))
        forever()
    if how == "prints a banner":
        say("Welcome to my planner 1.0")
        say("[1, 2]")
    if how == "is silent at its start":
        forever()


def hello():
    if how == "speaks another version":
        say('{"hello": 2}')
    elif how == "leaves the version out":
        say('{"name": "mine"}')
    elif how == "asks for observation by a word":
        say('{"hello": 1, "observation": "yes"}')
    else:
        say('{"hello": 1, "name": "unknown fields are ignored"}')


def reset():
    if how == "exits at reset":
        sys.exit(0)
    if how == "is silent at reset":
        forever()
    say('{"ready": false}' if how == "is not ready" else '{"ready": true}')


def step():
    if how == f"answers once too often at step {steps}":
        say(json.dumps(GOOD))
        time.sleep(0.05)
    if how == "answers an earlier step" and steps == 5:
        say(json.dumps({**GOOD, "t": 0.1}))
        return
    if how == "exits at step 7" and steps == 7:
        print("first line\nlast line", file=sys.stderr, flush=True)
        sys.exit(1)
    if how == "is killed" and steps == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    if how == "is silent":
        forever()
    if how == "ignores SIGTERM":
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        forever()
    if how == "leaves a child with the pipe":
        child = subprocess.Popen(["sleep", "600"])
        with open(sys.argv[2], "w") as file:
            file.write(str(child.pid))
        sys.exit(0)
    if how == "closes its output":
        os.close(1)
        forever()
    if how == "writes too much to its log":
        for _ in range(80):
            os.write(2, b"x" * (1 << 20))
    answers = {
        "sends half a line": lambda: (say('{"steer": 0.0, "thr', end=""), forever()),
        "sends a line of a gigabyte": lambda: [say("x" * (1 << 20), end="") for _ in range(1 << 10)],
        "sends deep JSON": lambda: say("[" * 100_000 + "]" * 100_000),
        "sends NaN": lambda: say('{"steer": NaN, "throttle": 0.0}'),
        "sends infinity": lambda: say('{"steer": 1e999, "throttle": 0.0}'),
        "sends bytes": lambda: os.write(1, b"\xff\xfe\x00{}\n"),
        "sends an empty line": lambda: say(""),
        "sends two lines": lambda: say(json.dumps(GOOD) + "\n" + json.dumps(GOOD)),
        "sends a list": lambda: say("[0.0, 0.1]"),
        "leaves throttle out": lambda: say('{"steer": 0.0}'),
        "sends a word": lambda: say('{"steer": "left", "throttle": 0.0}'),
        "sends null": lambda: say('{"steer": null, "throttle": 0.0}'),
        "sends two kinds": lambda: say('{"steer": 0.0, "throttle": 0.0, "plan": [[1, 0]]}'),
        "sends no kind": lambda: say('{"speed": 3.0}'),
        "sends an empty plan": lambda: say('{"plan": []}'),
        "sends a plan that is a number": lambda: say('{"plan": 3}'),
        "sends rows of five": lambda: say('{"plan": [[1, 0, 0, 3, 4]]}'),
        "sends rows of words": lambda: say('{"plan": [["1", 0]]}'),
        "sends a plan in the world's frame": lambda: say('{"plan": [[2713.5, -881.2]]}'),
        "keeps a plan for no step": lambda: say('{"plan": [[1, 0]], "again": 0}'),
        "keeps a control": lambda: say('{"steer": 0.0, "throttle": 0.0, "again": 5}'),
        "says what is wrong": lambda: say('{"error": "no route to the goal"}'),
    }
    answers.get(how, lambda: say(json.dumps(GOOD)))()


start()
for line in sys.stdin:
    message = json.loads(line)
    if "step" in message:
        step()
        steps += 1
    elif "reset" in message:
        reset()
    else:
        hello()

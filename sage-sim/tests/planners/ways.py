"""Offers two ways of following its plans, which go straight on. An argument says what it does besides."""

import json
import sys
import time

WAY = sys.argv[1] if len(sys.argv) > 1 else ""


def pause():
    if WAY == "sleeps":
        time.sleep(0.3)
    if WAY == "computes":
        end = time.process_time() + 0.6
        while time.process_time() < end:
            pass


follow = None
for line in sys.stdin:
    message = json.loads(line)
    if "hello" in message:
        answer = {"hello": 1, "follows": ["tracked", "exact"], "goal": WAY != "no goal"}
    elif "reset" in message:
        follow = message["reset"]["follow"]
        print(json.dumps(message["reset"]), file=sys.stderr, flush=True)
        answer = {"ready": True}
    else:
        step = message["step"]
        if step["t"] > 0.25:
            pause()
        metres = 5.0 if WAY == "jumps" else 0.8
        answer = {"plan": [[metres * (k + 1), 0.1 if WAY == "beside" else 0.0] for k in range(20)], "follow": follow}
    print(json.dumps(answer), flush=True)

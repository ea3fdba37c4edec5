"""Serves a class of Python as a planner: what `sage simulate --ego py:package.module:Class` starts.

    python3 -m advsage.serve package.module:Class
"""

import importlib
import os
import sys

from .sage_planner import serve


def main(name: str) -> None:
    """Makes the planner and answers `sage` until it closes the input."""
    module, _, planner = name.rpartition(":")
    # What the module prints when it is imported is no answer.
    answers = os.dup(1)
    os.dup2(2, 1)
    made = getattr(importlib.import_module(module), planner)()
    os.dup2(answers, 1)
    os.close(answers)
    serve(made, observation=True)


if __name__ == "__main__":
    main(*sys.argv[1:])

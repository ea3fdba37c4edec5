"""Serves a class of Python as a planner: what `sage simulate --ego py:package.module:Class` starts.

    python3 -m advsage.serve package.module:Class
"""

import importlib
import sys

from .sage_planner import keep_standard_output, serve


def main(name: str) -> None:
    """Makes the planner and answers `sage` until it closes the input."""
    module, _, planner = name.rpartition(":")
    # What the module prints when it is imported is no answer.
    keep_standard_output()
    serve(getattr(importlib.import_module(module), planner)(), observation=True)


if __name__ == "__main__":
    main(*sys.argv[1:])

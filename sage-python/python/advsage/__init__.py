"""Steerable adversarial traffic scenes for testing driving software. `import advsage as sage`."""

from . import _threads as _threads  # first: it sets variables that the module reads

from . import errors
from ._advsage import Attack, Generator, Scene, __version__, load, make, score, score_columns

__all__ = [
    "Attack",
    "Generator",
    "Scene",
    "errors",
    "load",
    "make",
    "score",
    "score_columns",
]

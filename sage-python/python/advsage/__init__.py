"""Steerable adversarial traffic scenes for testing driving software.

    import advsage as sage

    scene = sage.load("scene.pkl")
    attack = sage.Generator(lambda_=1.0)(scene)
    print(attack, sage.simulate(scene, "idm", attack))
"""

from . import _threads as _threads  # first: it sets variables that the module reads

from . import errors, planner
from ._advsage import (
    Attack,
    Episode,
    Generator,
    Picture,
    Scene,
    Scenes,
    __version__,
    convert,
    draw,
    evaluate,
    generate_many,
    inspect,
    load,
    load_folder,
    make,
    names,
    score,
    score_columns,
    simulate,
    simulate_many,
)
from ._results import Failure, Failures, Rates, Stress, rate, search, stress
from .errors import (
    FileError,
    FormatError,
    InternalError,
    MissingFile,
    OptionError,
    PlannerError,
    SageError,
    SceneError,
    UnknownName,
)

__all__ = [
    "Attack",
    "Episode",
    "Failure",
    "Failures",
    "FileError",
    "FormatError",
    "Generator",
    "InternalError",
    "MissingFile",
    "OptionError",
    "Picture",
    "PlannerError",
    "Rates",
    "SageError",
    "Scene",
    "SceneError",
    "Scenes",
    "Stress",
    "UnknownName",
    "convert",
    "draw",
    "errors",
    "evaluate",
    "generate_many",
    "inspect",
    "load",
    "load_folder",
    "make",
    "names",
    "planner",
    "rate",
    "score",
    "score_columns",
    "search",
    "simulate",
    "simulate_many",
    "stress",
]

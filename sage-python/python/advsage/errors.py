"""The errors of `advsage`. All are a `SageError` and one of Python's own classes.

    SageError
    ├── FormatError    (ValueError)         a file that is no scene, or holds no weights
    ├── SceneError     (ValueError)         a scene that lacks what the call needs
    ├── OptionError    (ValueError)         a value out of range, or an array of a wrong shape
    ├── UnknownName    (LookupError)        a name that nothing has: of a method, weights, a driver
    ├── FileError      (OSError)            a file that cannot be read or written
    │   └── MissingFile  (FileNotFoundError)
    ├── PlannerError   (RuntimeError)       a planner that raised, or answered nonsense
    └── InternalError  (RuntimeError)       a defect of this package
"""


class SageError(Exception):
    """Any error of this package."""


class FormatError(SageError, ValueError):
    """A file that is no scene or holds no weights: the message names file, field, value and remedy."""


class SceneError(SageError, ValueError):
    """A scene that lacks what the call needs, such as an adversary."""


class OptionError(SageError, ValueError):
    """A value that is out of range, or an array of a wrong shape."""


class UnknownName(SageError, LookupError):
    """A name that nothing has. The message lists the known ones."""


class FileError(SageError, OSError):
    """A file that cannot be read or written, with `errno` and `filename`."""


class MissingFile(FileError, FileNotFoundError):
    """A file or folder that does not exist."""


class PlannerError(SageError, RuntimeError):
    """A planner that raised, or answered nonsense. What it raised is the `__cause__`."""


class InternalError(SageError, RuntimeError):
    """A defect of this package: please report it."""

"""Sets the variables of candle's threads, before the compiled module first reads them.

candle asks for its number of threads at every product. Without the variables it starts a pool of threads in the calling
process, which costs twice the time, and a child made by `fork` waits for that pool for ever. One call works on one scene in one
thread; several scenes are worked on by `generate_many` and `search` in threads of their own.

`ADVSAGE_KEEP_THREADS=1` leaves the environment as it is.
"""

import os
import sysconfig
import warnings

VARIABLES = ("RAYON_NUM_THREADS", "CANDLE_NUM_THREADS")

if sysconfig.get_config_var("Py_GIL_DISABLED"):
    raise ImportError("advsage does not run on free-threaded Python; use a build with the global lock")

if os.environ.get("ADVSAGE_KEEP_THREADS") != "1":
    for _name in VARIABLES:
        os.environ.setdefault(_name, "1")
    _other = [f"{name}={os.environ[name]}" for name in VARIABLES if os.environ[name] != "1"]
    if _other:
        warnings.warn(
            f"{', '.join(_other)} is set, perhaps by another package: calls take more time, and a process that forks may hang. "
            "Set it to 1, or ADVSAGE_KEEP_THREADS=1 to say nothing.",
            RuntimeWarning,
            stacklevel=3,
        )

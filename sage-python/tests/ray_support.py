"""A small Ray cluster for tests."""

import contextlib
import os
import pathlib

HERE = str(pathlib.Path(__file__).parent)


@contextlib.contextmanager
def ray_cluster():
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    import ray

    environment = {"env_vars": {"PYTHONPATH": HERE}}
    ray.init(num_cpus=2, include_dashboard=False, logging_level="error", log_to_driver=False, runtime_env=environment)
    try:
        yield
    finally:
        ray.shutdown()

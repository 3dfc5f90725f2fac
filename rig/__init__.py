"""Calibrate a MEMS inertial unit traceably on a hardware-in-the-loop bench, and explain the sensor.

For notebooks: `from rig import open_run, Model`; what they take and return is said in `rig.notebook`. They are loaded
when they are asked for, so that the command line starts as quickly as the shell expects.
"""

from typing import Any

__version__ = "0.1.0"


def __getattr__(name: str) -> Any:
    """`open_run` and `Model` of `rig.notebook`."""
    if name not in ("Model", "open_run"):
        raise AttributeError(f"module 'rig' has no attribute '{name}'")
    import importlib

    return getattr(importlib.import_module("rig.notebook"), name)


def __dir__() -> list[str]:
    return [*globals(), "Model", "open_run"]

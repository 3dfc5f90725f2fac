"""Calibrate a MEMS inertial unit traceably on a hardware-in-the-loop bench, and explain the sensor.

For notebooks: `from rig import open_run, Model, counts_to_volts`; what they take and return is said in `rig.notebook`
and `rig.correction`. They are loaded when they are asked for, so that the command line starts as quickly as the shell
expects.
"""

from typing import Any

__version__ = "0.1.0"

_NAMES = {"Model": "rig.notebook", "open_run": "rig.notebook", "counts_to_volts": "rig.correction.correction"}


def __getattr__(name: str) -> Any:
    """`open_run` and `Model` of `rig.notebook`, `counts_to_volts` of `rig.correction`."""
    if name not in _NAMES:
        raise AttributeError(f"module 'rig' has no attribute '{name}'")
    import importlib

    return getattr(importlib.import_module(_NAMES[name]), name)


def __dir__() -> list[str]:
    return [*globals(), *_NAMES]

"""Calibrate a MEMS inertial unit traceably on a hardware-in-the-loop bench, and explain the sensor.

For notebooks: `from rig import open_run, Model` (see `rig.notebook`). They are loaded when they are asked for, so that
the command line starts as quickly as the shell expects.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rig.notebook import Model, open_run

__all__ = ["Model", "__version__", "open_run"]
__version__ = "0.1.0"


def __getattr__(name: str) -> Any:
    if name not in ("Model", "open_run"):
        raise AttributeError(f"module 'rig' has no attribute '{name}'")
    from rig import notebook

    return getattr(notebook, name)

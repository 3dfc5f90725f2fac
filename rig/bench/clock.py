"""The machine's own clock, for a bench of real instruments."""

from __future__ import annotations

import time


class SystemClock:
    """Bench time is the machine's time."""

    def now(self) -> float:
        """Seconds since 1970-01-01 UTC."""
        return time.time()

    def sleep(self, seconds: float) -> None:
        """Wait `seconds` ≥ 0 of real time."""
        time.sleep(seconds)

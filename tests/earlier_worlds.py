"""Worlds of the demonstration as they once were: what a hidden seed hid before more effects were drawn.

`rig demo hidden --seed N` draws from all that the simulated bench can hide, so a seed hides something else whenever a
kind is added or its sizes change. A failure seen at an old seed can be made again from here. `earlier_worlds.json` has
for every such seed the entries of a world's file with the strength d′ that they had; the bench was that of seed 1.
White noise was then stated by its rms at 3125 Hz, which stands here as its density; slow noise was another draw.
"""

from __future__ import annotations

import json
from functools import lru_cache
from pathlib import Path
from typing import Any

import fast_bench

from fixtures.world import World

KEPT = Path(__file__).with_suffix(".json")
BENCH_SEED = 1


@lru_cache(maxsize=1)
def _kept() -> dict[int, list[dict[str, Any]]]:
    return {int(seed): found for seed, found in json.loads(KEPT.read_text(encoding="utf-8")).items()}


def seeds() -> tuple[int, ...]:
    """Seeds that are kept."""
    return tuple(_kept())


def strengths(seed: int) -> list[float]:
    """d′ of each entry as it was counted then."""
    return [float(one["d_prime"]) for one in _kept()[seed]]


def hidden(seed: int) -> list[dict[str, Any]]:
    """What the seed hid, as a world's file lists it. KeyError for a seed that is not kept."""
    return [{"name": one["name"], "parameters": dict(one["parameters"])} for one in _kept()[seed]]


def world(seed: int) -> World:
    """The world of that seed, just begun."""
    return fast_bench.world(BENCH_SEED, hidden(seed))

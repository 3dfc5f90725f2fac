"""What the simulated bench lets a procedure know, without anything being started."""

from __future__ import annotations

import pytest

from rig.bench.benchfile import describe
from rig.bench.steps import BenchFacts
from rig.yaml.config import shipped


@pytest.fixture(scope="session")
def facts() -> BenchFacts:
    """Limits, rates and instruments of the shipped simulated bench."""
    return describe(shipped("benches/simulated.yaml")).facts()

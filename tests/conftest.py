"""What tests share: one served bench with the clean world, a way to have a bench of one's own, and processes."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

from rig.bench import control

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is loaded: as the program and the Makefile have it

settings.register_profile("any machine", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("any machine")  # no test asks how fast the machine is

CLEAN = Path(__file__).parents[1] / "configs" / "worlds" / "clean.yaml"
HERE = Path(__file__).parent


APART = {"test_commands", "test_docs", "test_golden_values", "test_guarded_run", "test_real_data",
         "test_shipped_procedures"}  # fmt: skip
"""Modules of long tests that share nothing: each may have a process to itself."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Whole commands first, so that no long one is left at the end."""
    items.sort(key=lambda one: one.path.parent != HERE)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """What a module makes once is made in one process: a unit of work is a module, in the order of collection.

    Groups by marks would do, but pytest 9.2 no longer reads the identity that pytest-xdist 3.8 writes them into.
    """
    from xdist.scheduler import LoadScopeScheduling

    class ByModule(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            module = nodeid.partition("::")[0]
            return nodeid if Path(module).stem in APART else module

    config.option.loadscopereorder = False
    return ByModule(config, log)


@pytest.fixture(scope="session", autouse=True)
def _locks_of_their_own(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Locks and armed states of the tests' benches are not this machine's."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_RUNTIME_DIR", str(tmp_path_factory.mktemp("runtime")))
        yield


@pytest.fixture(scope="session")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[control.Addresses]:
    """Addresses of a served bench with the clean world, seed 1. Tests share its world: leave it as you found it."""
    state = tmp_path_factory.mktemp("bench")
    yield control.ensure_served(CLEAN, 1, state, idle=120.0)
    control.stop(state)


@pytest.fixture
def own_bench(tmp_path: Path) -> Iterator[Callable[..., control.Addresses]]:
    """Serves a bench that a test has to itself, with the clean world unless told otherwise; stops it afterwards."""
    state = tmp_path / "bench"

    def serve(world: Path = CLEAN, seed: int = 1, idle: float = 120.0) -> control.Addresses:
        return control.ensure_served(world, seed, state, idle=idle)

    yield serve
    control.stop(state)

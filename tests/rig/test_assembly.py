"""Assembly: drivers found by name, mistakes of their settings located, instruments connected and closed again."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from rig.bench import assembly, control
from rig.bench.benchfile import BenchDescription, describe
from rig.bench.control import BenchClock, BenchOperator, Control
from rig.bench.roles import Energises
from rig.errors import BadInput, ConfigError, InstrumentError
from rig.yaml.config import shipped

SHIPPED = shipped("benches/simulated.yaml")
Written = Callable[..., BenchDescription]


@pytest.fixture
def written(tmp_path: Path) -> Written:
    """A bench file of one's own: the shipped one with pieces of its text replaced and the other files beside it."""

    def write(*pairs: tuple[str, str]) -> BenchDescription:
        text = SHIPPED.read_text(encoding="utf-8").replace("../", f"{SHIPPED.parents[1]}/")
        for old, new in pairs:
            assert old in text, old
            text = text.replace(old, new, 1)
        path = tmp_path / "mine.yaml"
        path.write_text(text, encoding="utf-8")
        return describe(path)

    return write


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A runs folder whose simulated bench is stopped at the end."""
    folder = tmp_path_factory.mktemp("assembly") / "runs"
    yield folder
    for state in (folder / ".bench").glob("*"):
        control.stop(state)


def said(description: BenchDescription) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        assembly.fittings(description)
    return [f"{p.key}: {p.text}" for p in caught.value.problems]


def test_every_instrument_of_the_shipped_benches_has_a_driver_that_takes_its_settings() -> None:
    for name in ("simulated", "hardware"):
        description = describe(shipped(f"benches/{name}.yaml"))
        found = assembly.fittings(description)
        assert set(found) == set(description.file.instruments)
        assert all(fitting.module.__name__ == f"drivers.{fitting.driver}" for fitting in found.values())


@pytest.mark.parametrize(
    ("driver", "text"),
    [
        ("os.path", "found driver 'os.path', wanted a plain name such as 'hp89410a'"),
        ("drivers.hp89410a", "found driver 'drivers.hp89410a', wanted a plain name such as 'hp89410a'"),
        ("../hp89410a", "found driver '../hp89410a', wanted a plain name"),
        ("hp99999z", "found no driver 'hp99999z', wanted a module of `drivers` or an entry point of `rig.drivers`"),
    ],
)
def test_a_driver_that_is_no_plain_known_name_is_refused_and_nothing_is_imported(
    written: Written, driver: str, text: str
) -> None:
    (line,) = said(written(("driver: hp89410a", f"driver: {driver}")))
    assert line.startswith(f"instruments.analyzer.driver: {text}")


def test_a_module_of_drivers_that_is_no_driver_is_refused(written: Written) -> None:
    (line,) = said(written(("driver: hp89410a", "driver: links")))
    assert line.startswith("instruments.analyzer.driver: found ")


def test_every_instrument_s_mistakes_are_told_at_once_where_they_stand(written: Written) -> None:
    description = written(
        ("driver: hp54542a", "driver: hp54543a"),
        ("decoder: OVD-01", "decoder: OVD-99, colour: red"),
        ("{driver: encoder}", "{driver: encoder, high: soon}"),
    )
    with pytest.raises(ConfigError) as caught:
        assembly.fittings(description)
    text = description.path.read_text(encoding="utf-8").splitlines()
    found = [(p.key, text[p.line - 1][p.column - 1 :]) for p in caught.value.problems]
    assert [(key, rest.split(",")[0].split("}")[0]) for key, rest in found] == [
        ("instruments.scope.driver", "hp54543a"),
        ("instruments.vibrometer.decoder", "OVD-99"),
        ("instruments.vibrometer.colour", "colour: red"),
        ("instruments.encoder.high", "soon"),
    ]


def test_an_entry_without_a_driver_says_that_it_wants_one(written: Written) -> None:
    (line,) = said(written(("{driver: encoder}", "{}")))
    assert line.startswith("instruments.encoder.driver: found ")
    assert ", wanted " in line


def test_only_the_roles_wanted_are_connected_and_those_that_energise_are_charged(runs: Path) -> None:
    wanted = {"analyzer", "vibrometer", "filter"}
    with assembly.connected(describe(SHIPPED), runs, wanted.__contains__) as bench:
        assert set(bench.instruments) == wanted
        assert [charge.name for charge in bench.charges] == ["analyzer"]
        assert isinstance(bench.instruments["analyzer"], Energises)
        assert bench.instruments["analyzer"].identify().model == "89410A"
        assert isinstance(bench.room.clock, BenchClock)
        assert isinstance(bench.room.operator, BenchOperator)
        assert "${" not in str(bench.charges[0].settings)


def test_connecting_changes_nothing_and_leaving_closes_every_link(runs: Path) -> None:
    with assembly.connected(describe(SHIPPED), runs) as bench:
        analyzer = bench.instruments["analyzer"]
        assert bench.control is not None
        before = bench.control.ask("log")["events"]
        assert set(bench.instruments) == set(describe(SHIPPED).file.instruments)
        assert bench.control.ask("log")["events"] == before
    with pytest.raises(InstrumentError):
        analyzer.identify()


def test_a_simulated_bench_is_started_once_for_a_runs_folder(runs: Path) -> None:
    description = describe(SHIPPED)
    first, again = (assembly.start_simulated(description, runs) for _ in range(2))
    assert first == again
    assert assembly.state_folder(description, runs) == runs / ".bench" / "simulated"
    with Control(int(str(first["control"]))) as link:
        assert link.ask("hello")["seed"] == 1


def test_nothing_of_the_working_folder_is_imported_by_the_bench(
    runs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("yaml", "numpy", "asyncio"):
        (tmp_path / f"{name}.py").write_text(f'raise SystemExit("a {name}.py of the working folder was executed")')
    description = describe(SHIPPED)
    monkeypatch.chdir(tmp_path)
    assert assembly.start_simulated(description, runs)


def test_a_bench_with_another_world_does_not_get_the_world_that_is_there(runs: Path, written: Written) -> None:
    assembly.start_simulated(describe(SHIPPED), runs)
    with pytest.raises(BadInput, match="seed 1, wanted seed 2"):
        assembly.start_simulated(written(("seed: 1", "seed: 2")), runs)


def test_an_odd_bench_name_stays_inside_the_runs_folder(tmp_path: Path, written: Written) -> None:
    description = written(("bench: simulated\nsimulated", 'bench: "../../x y"\nsimulated'))
    folder = assembly.state_folder(description, tmp_path)
    assert folder.resolve().parent == (tmp_path / ".bench").resolve()


def test_the_bench_s_clock_on_a_bench_of_real_instruments_is_bad_input(written: Written, runs: Path) -> None:
    description = written(("simulated: {world: ", "#"))
    with pytest.raises(BadInput, match="wanted a simulated bench"), assembly.connected(description, runs):
        pass


def test_a_bench_of_real_instruments_is_not_served(runs: Path) -> None:
    with pytest.raises(BadInput, match="found a bench of real instruments"):
        assembly.start_simulated(describe(shipped("benches/hardware.yaml")), runs)

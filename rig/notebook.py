"""For notebooks: open runs, compare a model with them, ask what is missing, add it, watch the error fall.

    from rig import Model, open_run

    model = Model("runs/2026-11-02T080000-sweep-x")
    model.diagnose().candidates[0].effect      # 'cubic'
    model.add("cubic")
    [(step.effect, step.error) for step in model.history]
    model.apply({"unit_a_x": volts}, rate=3125.0).values["unit_a_x"]      # m/s²

Everything is SI inside; errors are in units of the noise, so that 1.0 is a model with nothing missing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rig.archive.records import Recorded, Records
from rig.errors import BadInput
from rig.model import Quantity, Term

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from rig.correction.correction import Corrected, Correction
    from rig.diagnose.conclusion import Conclusion
    from rig.diagnose.misfit import Comparison
    from rig.fit.fit import Fit
    from rig.repair.model_file import Model as ModelFile
    from rig.repair.model_file import Start, Step


def open_run(path: str | Path) -> Records:
    """One run for reading: `path` is its folder; `<folder of runs>/last` is the newest run there.

    Of the result, `header` holds what was known before the run, `points` what was measured by index, `samples(name)`
    one record of the converter: `counts` of shape (scans, channels), `volts(channel)` in V of shape (scans,),
    `instants(channel)` in s of shape (scans,). Raises BadInput if there is no such run.
    """
    from rig.archive.runs import Runs

    path = Path(path)
    return Records(Runs(path.parent).open(path.name))


def records_of(names: Sequence[str], runs: Path) -> list[Records]:
    """Runs of a folder by name, `last`, or `all` for every completed one, each once. Raises BadInput."""
    from rig.archive.runs import Runs

    archive = Runs(runs)
    if tuple(names) == ("all",):
        names = [run.name for run in archive.list() if run.status == "completed"] or ["last"]
    opened = [archive.open(name) for name in names]
    return [Records(run) for run in dict.fromkeys(opened)]


class Model:
    """A model of one unit, fitted to all its runs together.

    `runs`: folders of runs, or what `open_run` returned. `start`: "datasheet" (sensitivity S, zero output V₀ and one
    pole of the output filter for every channel), "paper" (S and V₀ only), or "shared" (one S for all channels of a
    quantity). `effects`: a folder with effects of one's own. `add` and `remove` change the model and return it, so that
    calls can be chained. Raises BadInput for runs of several units and for runs that no model can be compared with.
    """

    def __init__(self, *runs: str | Path | Recorded, start: Start = "datasheet", effects: Path | None = None) -> None:
        from rig.repair import repair
        from rig.shelf import shelf

        if not runs:
            raise BadInput("Model: found no run, wanted at least one")
        records = [open_run(run) if isinstance(run, str | Path) else run for run in runs]
        self._bench = repair.bench_of(records, shelf(effects))
        self._done = repair.fitted(self._bench, repair.new(self._bench, start))

    @property
    def file(self) -> ModelFile:
        """The model as a value that `model_file.save` writes: effects, uncertainties, covariance, history."""
        return self._done.model

    @property
    def fit(self) -> Fit:
        """The fit: `left` rows in standard deviations, shape (rows,), `chi2`, `count`, `covariance` (n, n), SI."""
        return self._done.fit

    @property
    def terms(self) -> list[Term]:
        """The effects of the model at their coordinates, SI."""
        return [term for term in self.fit.state.terms if not term.prior]

    @property
    def history(self) -> tuple[Step, ...]:
        """Every step: `action`, `effect`, `error` and `heldout` (error ÷ noise, dimensionless), `chi2_dof`."""
        return self._done.model.history

    def compare(self) -> Comparison:
        """Error against noise by group of rows: `groups`, `worst` conditions in words, tests of whiteness."""
        from rig.diagnose.misfit import compare

        return compare(self._bench.evidence, self.terms, self._done.model.poles, self._done.model.shared)

    def diagnose(self) -> Conclusion:
        """What is missing: `verdict`, `candidates` best first with parameters (SI value, unit, u), `cannot_see`."""
        from rig.diagnose.conclusion import conclude

        model = self._done.model
        return conclude(self._bench.evidence, self.terms, self._bench.shelf, poles=model.poles, shared=model.shared)

    def add(
        self, name: str, on: Quantity | None = None, *, formula: str | None = None, channels: Sequence[str] = ()
    ) -> Model:
        """Add an effect of the shelf, or a term by formula (`k * omega**2`), and refit. Raises BadInput.

        `channels` of its quantity that alone have it, by name.
        """
        from rig.repair import repair

        self._done = repair.added(self._bench, self._done.model, name, on, formula, channels)
        return self

    def remove(self, name: str, on: Quantity | None = None, *, channels: Sequence[str] = ()) -> Model:
        """Take an effect out and refit. Raises BadInput if it is not in the model."""
        from rig.repair import repair

        self._done = repair.removed(self._bench, self._done.model, name, on, channels)
        return self

    @property
    def correction(self) -> Correction:
        """The model turned round, as `apply` uses it and `rig export --model` writes it."""
        from rig.repair.correction import correction_of

        return correction_of(self.file, self._bench.shelf)

    def apply(
        self, raw: Mapping[str, ArrayLike] | ArrayLike, *, rate: float | None = None,
        temperature: ArrayLike | None = None, supply: ArrayLike | None = None, time: ArrayLike | None = None,
    ) -> Corrected:  # fmt: skip
        """What the unit went through, from what it showed: m/s² and rad/s from V, by channel in `values`.

        `raw`: volts by channel's name, numbers or records of one shape, or an array (channels, …) in the order of
        `correction.names`; `counts_to_volts` makes volts of counts. `rate`: samples per second of a record, along its
        last axis; with it filters and delays are taken out too. `temperature` °C, `supply` V and `time` s since the
        first record began: numbers, or one for each sample. What is not undone is in `said`, a sentence each; `u` are
        standard uncertainties by what is known of sensitivity and zero. Raises BadInput.
        """
        return self.correction.apply(raw, rate=rate, temperature=temperature, supply=supply, time=time)

    def __repr__(self) -> str:
        effects = ", ".join(entry.effect for entry in self.file.effects) or "no effect"
        return f"<Model of {self.file.unit}: {self.file.start}, {effects}, error {self.history[-1].error:.4g}>"

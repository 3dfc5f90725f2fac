"""docs/reference/faults.md from the outcomes of the fault matrix."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence

from fault_outcomes import BAD, OUTCOMES, Outcome
from faulty_bench import PROCEDURES, Cell

WHY: Sequence[tuple[str, str]] = (
    ("duplicat|doubled frame", "what is left over is thrown away before the next question"),
    ("flipped bit at|spectrum", "one line of a spectrum of two hundred, beside those that are read"),
    ("trace, flipped|preamble, flipped", "the last digits, or one sample of thousands"),
    ("output, flipped|range, flipped|level, flipped|identity, flipped", "what it tells is still allowed, and was set"),
    (
        "identity: |samples: |restarts",
        "damaged frames are known by their check sum, lost ones by their number; asked again",
    ),
    ("previous answer|one answer behind|stop, ", "the answer before was the same, or is not needed"),
    ("overload number|told", "the setting itself is as it was asked for"),
    ("second client", "whoever does not own the board is refused; what is heard by the way is thrown away"),
    ("metadata", "nothing stands on it"),
    ("scan, not counted", "one scan of thousands more, at rest or between whole revolutions"),
    ("clock", "means at rest do not depend on time, densities by less than their uncertainty"),
    ("reads 2 % less", "within twice the stated uncertainty of the vibrometer"),
    ("encoder", "well above or below what tells its two states apart"),
    ("hanging bit", "the bit is set anyway, or nothing stands on this channel here"),
    ("clipped|loose|spikes|stuck|inverted|dead", "nothing stands on this channel here, or less is cut off than shows"),
    ("tilted", "the direction of gravity is found from the poses themselves"),
    ("swapped|sees", "what they show is the same within its uncertainty"),
    ("operator", "what was asked for was so already, or is not used"),
    ("", "within its uncertainty"),
)
"""What may be why a fault does no harm, by the first words that its cell has; nobody has looked at each."""

KNOWN: Sequence[tuple[str, str]] = (
    (
        "unit_a_x and unit_b_x swapped",
        "like sensors along one axis, which no measurement of these benches tells apart; a certificate says that",
    ),
)
"""What is said of a fault that the program does not see."""

HEAD = """# What a fault of the bench does

Made by `make faults`. Each cell plants one fault between the program and the simulated bench, or in that bench, and
runs the program as a shell does: drivers over the wire, procedure, guard, archive, calibration. Told by number:

- *error*: a deliberate one, exit code 1, 2 or 3, that names where;
- *flagged*: values that the fault touches are flagged, fail, or are not determined, or a finding says that something is
  wrong;
- *harmless*: every value is within twice its own expanded uncertainty of the truth (of zero outputs and noise: of what
  is found without the fault), and nothing is said; the numbers stand at the end, with what may be why by the kind of
  fault. Twice, because one value in twenty is further off than its uncertainty by chance: what shifts a value by less
  than that is not told from none;
- **silent**: a value is further off, and nothing says so; **hang**; **traceback**: an error that is not deliberate;
  **unnamed**: an error that does not say where.
"""


STALE = """
{} of the cells were not run again since the program or the matrix has changed: they say what an earlier state did.
"""


def page(outcomes: Mapping[Cell, Outcome], stale: int = 0) -> str:
    """The page as Markdown; `stale` cells were run with other sources."""
    faulty = {cell: one for cell, one in outcomes.items() if cell.fault != "none"}
    counts = ", ".join(f"{n} {kind}" for kind in OUTCOMES if (n := sum(o.kind == kind for o in faulty.values())))
    lines = [HEAD, f"{len(faulty)} cells: {counts}.", *([STALE.format(stale)] if stale else [""])]
    for procedure in PROCEDURES:
        rows = {cell: one for cell, one in faulty.items() if cell.procedure == procedure}
        lines += [f"## {procedure}", "", *_table(rows), ""] if rows else []
    lines += _listed("What must not be", faulty, BAD)
    lines += ["## Harmless, by number", "", *_harmless(faulty)]
    return "\n".join(lines).rstrip() + "\n"


def _table(rows: Mapping[Cell, Outcome]) -> Iterator[str]:
    """One line for each instrument and outcome: its faults."""
    yield "| instrument | outcome | faults |"
    yield "|---|---|---|"
    for instrument in dict.fromkeys(cell.instrument for cell in rows):
        for kind in OUTCOMES:
            faults = [c.fault for c, one in rows.items() if c.instrument == instrument and one.kind == kind]
            if faults:
                yield f"| {instrument} | {f'**{kind}**' if kind in BAD else kind} | {', '.join(faults)} |"


def _harmless(rows: Mapping[Cell, Outcome]) -> Iterator[str]:
    """Faults with one number and one reason in one line."""
    grouped: dict[tuple[str, str, str], list[str]] = {}
    for cell, one in rows.items():
        if one.kind == "harmless":
            why = next(text for words, text in WHY if re.search(words, cell.name))
            grouped.setdefault((cell.procedure, one.words, why), []).append(f"{cell.instrument}: {cell.fault}")
    yield "| procedure | faults | the row that is furthest off | by its kind, probably because |"
    yield "|---|---|---|---|"
    for (procedure, words, why), faults in grouped.items():
        yield f"| {procedure} | {'; '.join(faults)} | {words} | {why} |"


def _listed(title: str, rows: Mapping[Cell, Outcome], kinds: tuple[str, ...]) -> list[str]:
    found = [
        "; ".join([f"- {cell.name}: {one.words}", *(text for words, text in KNOWN if words in cell.name)])
        for cell, one in rows.items() if one.kind in kinds
    ]  # fmt: skip
    return [f"## {title}", "", *(found or ["None."]), ""]

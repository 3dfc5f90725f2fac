"""docs/reference/faults.md from the outcomes of the fault matrix."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from fault_outcomes import BAD, OUTCOMES, Outcome
from faulty_bench import PROCEDURES, Cell

HEAD = """# What a fault of the bench does

Made by `make faults`. Each cell plants one fault between the program and the simulated bench, or in that bench, and
runs the program as a shell does: drivers over the wire, procedure, guard, archive, calibration. Told by number:

- *error*: a deliberate one, exit code 1, 2 or 3, that names where;
- *flagged*: values that the fault touches are flagged, fail, or are not determined, or a finding says that something is
  wrong;
- *harmless*: every value is within twice its own expanded uncertainty of the truth (of zero outputs and noise: of what
  is found without the fault), and nothing is said; the numbers stand at the end;
- **silent**: a value is further off, and nothing says so; **hang**; **traceback**: an error that is not deliberate;
  **unnamed**: an error that does not say where.
"""


def page(outcomes: Mapping[Cell, Outcome]) -> str:
    """The page as Markdown."""
    faulty = {cell: one for cell, one in outcomes.items() if cell.fault != "none"}
    counts = ", ".join(f"{n} {kind}" for kind in OUTCOMES if (n := sum(o.kind == kind for o in faulty.values())))
    lines = [HEAD, f"{len(faulty)} cells: {counts}.", ""]
    for procedure in PROCEDURES:
        rows = {cell: one for cell, one in faulty.items() if cell.procedure == procedure}
        lines += [f"## {procedure}", "", *_table(rows), ""] if rows else []
    lines += _listed("What must not be", faulty, BAD)
    lines += _listed("Harmless, by number", faulty, ("harmless",))
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


def _listed(title: str, rows: Mapping[Cell, Outcome], kinds: tuple[str, ...]) -> list[str]:
    found = [f"- {cell.name}: {one.words}" for cell, one in rows.items() if one.kind in kinds]
    return [f"## {title}", "", *(found or ["None."]), ""]

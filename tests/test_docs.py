"""The documentation says what is true: its commands run and print what it shows, and its links lead somewhere."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import in_process
import pytest

from rig.bench import control

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
RUNNABLE = [ROOT / "README.md", *sorted((DOCS / "tutorial").glob("*.md")), *sorted((DOCS / "how-to").glob("*.md"))]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md", *sorted(DOCS.rglob("*.md"))]
CONSOLE = re.compile(r"^ *```console\n(.*?)^ *```$", re.MULTILINE | re.DOTALL)
WRITTEN = re.compile(r"^```yaml\n# (\w+\.yaml)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
STAMP = re.compile(r"\d{4}-\d\d-\d\dT\d{6}")  # in the name of a run: when it was taken
NUMBER = re.compile(r"\d+(?:\.\d+)?")
SAME = 0.15  # relative: a page shows numbers of one machine and one day
HEADING = re.compile(r"^#+ (.+)$", re.MULTILINE)
LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")


@dataclass(frozen=True)
class Command:
    """One command of a page, where it stands, and what the page promises: an exit code, and lines that are printed."""

    line: int
    text: str
    code: int
    shown: tuple[str, ...] = ()

    @property
    def words(self) -> list[str]:
        """The words behind `rig` as a shell would split them."""
        rig, *rest = shlex.split(self.text)
        assert rig == "rig"
        return rest


def commands(page: str) -> Iterator[Command]:
    """The lines `$ rig …` of all console blocks, in order; `# exit 2` at the end promises that exit code.

    Lines below a command are some of those that it prints; `…` stands for others.
    """
    for block in CONSOLE.finditer(page):
        lines = [
            (line.strip(), page.count("\n", 0, block.start(1)) + 1 + n) for n, line in enumerate(block[1].splitlines())
        ]
        starts = [n for n, (line, _) in enumerate(lines) if line.startswith("$ rig ")]
        for start, end in zip(starts, [*starts[1:], len(lines)], strict=True):
            line, number = lines[start]
            text, _, promise = line.removeprefix("$ ").partition("  # exit ")
            shown = tuple(line for line, _ in lines[start + 1 : end] if line not in ("", "…"))
            yield Command(number, text, int(promise or 0), shown)


def alike(shown: str, printed: str) -> bool:
    """Whether a page's line is one that was printed: the same words, and nearly the same numbers."""
    one, other = (" ".join(STAMP.sub("STAMP", line).split()) for line in (shown, printed))
    if NUMBER.sub("#", one) != NUMBER.sub("#", other):
        return False
    if one.startswith("took "):  # how long it was, and what of
        return True
    pairs = zip(NUMBER.findall(one), NUMBER.findall(other), strict=True)
    return all(abs(float(a) - float(b)) <= SAME * abs(float(b)) for a, b in pairs)


def unprinted(command: Command, said: str) -> list[str]:
    """Lines that a page shows below a command and that were not printed, in this order."""
    rest, missing = said.splitlines(), []
    for line in command.shown:
        found = next((n for n, one in enumerate(rest) if alike(line, one)), None)
        if found is None:
            missing.append(line)
        else:
            rest = rest[found + 1 :]
    return missing


def write_files(page: str, folder: Path) -> None:
    """Files that the page tells its reader to write: YAML blocks that begin with a comment naming the file."""
    for block in WRITTEN.finditer(page):
        (folder / block[1]).write_text(block[2], encoding="utf-8")


def targets(page: Path) -> Iterator[str]:
    """Relative links of a page, outside code blocks."""
    text = re.sub(r"^ *```.*?^ *```$", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    for target in LINK.findall(text):
        if not re.match(r"[a-z]+:", target):
            yield target


def anchors(page: Path) -> set[str]:
    """What a link to a page may have behind `#`: its headings, as GitHub writes them."""
    text = re.sub(r"^ *```.*?^ *```$|<!--.*?-->", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    return {re.sub(r"[^\w\- ]", "", found.strip().lower()).replace(" ", "-") for found in HEADING.findall(text)}


def leads(page: Path, target: str) -> bool:
    """Whether a link of a page leads to a file, and to a heading in it if it names one."""
    path, _, anchor = target.partition("#")
    there = page.parent / path if path else page
    return there.exists() and (not anchor or anchor in anchors(there))


def prose(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


@pytest.mark.timeout(900)
@pytest.mark.parametrize(
    "page", [page for page in RUNNABLE if any(commands(page.read_text(encoding="utf-8")))], ids=prose
)
def test_every_command_of_a_page_ends_and_prints_as_the_page_says(page: Path, tmp_path: Path) -> None:
    text = page.read_text(encoding="utf-8")
    write_files(text, tmp_path)
    wrong: list[tuple[str, str]] = []
    try:
        for command in commands(text):
            done = in_process.rig(*command.words, folder=tmp_path)
            said = f"{prose(page)}:{command.line}: {command.text}\n{done.stdout}{done.stderr}"
            assert done.returncode == command.code, said
            wrong += [(said, missing) for missing in unprinted(command, done.stdout + done.stderr)]
    finally:
        control.stop(tmp_path / "runs" / ".bench" / "simulated")
    assert not wrong, "\n\n".join(f"{said}\nshown, but not printed: {missing}" for said, missing in wrong)


@pytest.mark.parametrize("page", PAGES, ids=prose)
def test_every_relative_link_of_a_page_leads_to_a_file_and_a_heading(page: Path) -> None:
    assert not [target for target in targets(page) if not leads(page, target)]


def test_a_promised_exit_code_is_read_and_other_blocks_are_left_alone() -> None:
    left_alone = "```text\n$ rig resume last\n```\n\n"
    page = left_alone + "```console\n$ rig runs\nno runs\n$ rig sweep --axis x --stop 5  # exit 2\n```\n"
    assert [(c.line, c.text, c.code) for c in commands(page)] == [
        (6, "rig runs", 0),
        (8, "rig sweep --axis x --stop 5", 2),
    ]


def test_what_is_shown_and_not_printed_is_found() -> None:
    page = "```console\n$ rig verify\nfirst 1.00 s\n…\n  last\n```\n"
    (command,) = commands(page)
    assert command.shown == ("first 1.00 s", "last")
    assert not unprinted(command, "first 1.05 s\nother\n last\n")
    assert unprinted(command, "first 2.00 s\n last\n") == ["first 1.00 s"]
    assert unprinted(command, "last\nfirst 1.00 s\n") == ["last"]
    assert alike("run 2026-11-24T160245-sweep-x", "run 2027-01-01T000000-sweep-x")


def test_a_link_to_a_heading_that_is_not_there_is_found(tmp_path: Path) -> None:
    page = tmp_path / "a.md"
    page.write_text("# Bench file\n\n## Sensors: what *is* there\n", encoding="utf-8")
    assert leads(page, "#sensors-what-is-there")
    assert leads(page, "a.md#bench-file")
    assert not leads(page, "a.md#bench")
    assert not leads(page, "b.md")

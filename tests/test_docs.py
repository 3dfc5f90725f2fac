"""The documentation says what is true: its commands run and its links lead somewhere."""

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
LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")


@dataclass(frozen=True)
class Command:
    """One command of a page, where it stands, and the exit code that the page promises."""

    line: int
    text: str
    code: int

    @property
    def words(self) -> list[str]:
        """The words behind `rig` as a shell would split them."""
        rig, *rest = shlex.split(self.text)
        assert rig == "rig"
        return rest


def commands(page: str) -> Iterator[Command]:
    """The lines `$ rig …` of all console blocks, in order; `# exit 2` at the end promises that exit code."""
    for block in CONSOLE.finditer(page):
        first = page.count("\n", 0, block.start(1)) + 1
        for number, line in enumerate(block[1].splitlines(), start=first):
            if line.strip().startswith("$ rig "):
                text, _, promise = line.strip().removeprefix("$ ").partition("  # exit ")
                yield Command(number, text, int(promise or 0))


def write_files(page: str, folder: Path) -> None:
    """Files that the page tells its reader to write: YAML blocks that begin with a comment naming the file."""
    for block in WRITTEN.finditer(page):
        (folder / block[1]).write_text(block[2], encoding="utf-8")


def targets(page: Path) -> Iterator[str]:
    """Relative links of a page, without the part behind `#`, outside code blocks."""
    text = re.sub(r"^ *```.*?^ *```$", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    for target in LINK.findall(text):
        if not re.match(r"[a-z]+:|#", target):
            yield target.partition("#")[0]


def prose(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


@pytest.mark.timeout(900)
@pytest.mark.parametrize(
    "page", [page for page in RUNNABLE if any(commands(page.read_text(encoding="utf-8")))], ids=prose
)
def test_every_command_of_a_page_ends_as_the_page_says(page: Path, tmp_path: Path) -> None:
    text = page.read_text(encoding="utf-8")
    write_files(text, tmp_path)
    try:
        for command in commands(text):
            done = in_process.rig(*command.words, folder=tmp_path, RIG_RUNS=str(tmp_path / "runs"))
            said = f"{prose(page)}:{command.line}: {command.text}\n{done.stdout}{done.stderr}"
            assert done.returncode == command.code, said
    finally:
        control.stop(tmp_path / "runs" / ".bench" / "simulated")


@pytest.mark.parametrize("page", PAGES, ids=prose)
def test_every_relative_link_of_a_page_leads_to_a_file(page: Path) -> None:
    missing = [target for target in targets(page) if not (page.parent / target).exists()]
    assert not missing


def test_a_promised_exit_code_is_read_and_other_blocks_are_left_alone() -> None:
    left_alone = "```text\n$ rig resume last\n```\n\n"
    page = left_alone + "```console\n$ rig runs\nno runs\n$ rig sweep --axis x --stop 5  # exit 2\n```\n"
    assert [(c.line, c.text, c.code) for c in commands(page)] == [
        (6, "rig runs", 0),
        (8, "rig sweep --axis x --stop 5", 2),
    ]

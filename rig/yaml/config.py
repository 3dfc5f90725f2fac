"""Settings from YAML; a mistake is named by file, line, column, key, what was found and what was wanted.

    settings = load(path, Settings)              # raises ConfigError with every mistake of the file

    document = read(path)                        # for checks that come later than the types
    settings, problems = check(document, Settings)
    problems.append(document.problem(("stop",), "found 5 Hz, wanted more than start (20 Hz)"))

Values are checked strictly: '24' in quotes is not a number, and a number is not text.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from rig.errors import BadInput, ConfigError, Problem, WorkFailed
from rig.yaml.document import Document, KeyPath, dotted, read, read_text, shown

if TYPE_CHECKING:
    from pydantic import BaseModel

    M = TypeVar("M", bound=BaseModel)

__all__ = [
    "SCHEMAS", "Document", "KeyPath", "check", "dotted", "json_schema", "load", "load_mapping", "locate",
    "program_version", "read", "read_text", "schemas", "shipped", "validate",
]  # fmt: skip

HERE = Path(__file__).parent.parent
SCHEMAS = Path("docs/reference/schemas")


def load(path: Path, model: type[M]) -> M:
    """Read a file into a model; raises ConfigError with every mistake in it."""
    return validate(read(path), model)


def load_mapping(path: Path) -> dict[str, Any]:
    """Read a file whose top is a mapping, without a model; raises ConfigError."""
    document = read(path)
    if not isinstance(document.data, dict):
        raise ConfigError([document.problem((), f"found {shown(document.root)}, wanted a mapping of keys")])
    return document.data


def validate(document: Document, model: type[M], at: KeyPath = ()) -> M:
    """The model's value of the part of the document at `at`; raises ConfigError with every mistake in it."""
    value, problems = check(document, model, at)
    if value is None:
        raise ConfigError(problems)
    return value


def check(document: Document, model: type[M], at: KeyPath = ()) -> tuple[M | None, list[Problem]]:
    """Like `validate`, with the mistakes returned, so that those of several parts can be shown together."""
    from pydantic import ValidationError

    from rig.yaml import mistakes

    part = document.data
    for step in at:
        part = part[step]
    try:
        # As JSON, strict types still let a list be a tuple and a text be a date.
        return model.model_validate_json(json.dumps(part), strict=True), []
    except ValidationError as error:
        return None, mistakes.problems(document, model, at, error)


def locate(document: Document, path: KeyPath) -> tuple[int, int]:
    """Line and column (from one) of the value at `path`, e.g. ("steps", 2, "stop"), or of what surrounds it."""
    return document.locate(path)


def json_schema(model: type[BaseModel]) -> dict[str, Any]:
    """The model's JSON schema for editors: quantities are text with a unit, in their defaults too."""
    from rig.yaml.mistakes import schema

    return schema(model)


def shipped(relative: str, package: Path = HERE) -> Path:
    """A file or folder under the `configs` that ship with the program, e.g. `shipped("benches/simulated.yaml")`.

    In an installed wheel they are inside the package, in a checkout beside it. Raises BadInput if there is none.
    """
    return _beside(package, Path("configs") / relative)


def schemas(package: Path = HERE) -> Path:
    """The folder of JSON schemas that ship with the program, one for each kind of YAML file. Raises BadInput."""
    return _beside(package, SCHEMAS)


def program_version(package: Path = HERE) -> dict[str, str]:
    """What a record says of the program that made it: `version`, and `lock_sha256` of the locked dependencies."""
    from rig import __version__

    try:
        lock = _beside(package, Path("requirements-run.lock")).read_bytes()
    except (BadInput, OSError) as error:
        raise WorkFailed(f"the program's own installation: {error}") from error
    return {"version": __version__, "lock_sha256": hashlib.sha256(lock).hexdigest()}


def _beside(package: Path, relative: Path) -> Path:
    root = package if (package / relative.parts[0]).exists() else package.parent
    if not (root / relative).exists():
        raise BadInput(f"{root}: found no {relative}, wanted it to be installed with the program")
    return root / relative

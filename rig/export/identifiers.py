"""Names that C and Python take, of names that people gave: safe, readable, and never two alike."""

from __future__ import annotations

import unicodedata
from collections.abc import Sequence


def identifiers(names: Sequence[str], reserved: Sequence[str] = ()) -> dict[str, str]:
    """One for each name, of letters, digits and underscores, different even where capitals count for nothing.

    None of those that are `reserved`.
    """
    found: dict[str, str] = {}
    taken = {one.upper() for one in reserved}
    for name in dict.fromkeys(names):
        plain = _plain(name)
        free = next(one for one in _numbered(plain) if one.upper() not in taken)
        taken.add(free.upper())
        found[name] = free
    return found


def _numbered(plain: str) -> Sequence[str]:
    return [plain, *(f"{plain}_{number}" for number in range(2, 1000))]


def _plain(name: str) -> str:
    spelled = "".join(_spelled(c) for c in unicodedata.normalize("NFKD", name) if not unicodedata.combining(c))
    return spelled.strip("_") or "channel"


def _spelled(c: str) -> str:
    """A letter or digit as it is, a Greek letter by its name, anything else as an underscore."""
    if c.isascii():
        return c if c.isalnum() else "_"
    words = unicodedata.name(c, "").split()
    if "LETTER" in words and words[0] == "GREEK":
        letter = words[words.index("LETTER") + 1].lower()
        return letter.capitalize() if "CAPITAL" in words else letter
    return f"u{ord(c):x}" if c.isalnum() else "_"

"""Every deliberate error of the program, drawn as a tree.

    RigError                         exit code
    ├── BadInput                     2    what the user gave cannot be used
    │   ├── ConfigError                   mistakes in a YAML file, all of them at once
    │   ├── LimitExceeded                 a point asks for more than the instrument can or the bench may
    │   ├── OperatorMissing               a confirmation is needed and nobody can give it
    │   └── StandardOverdue               a reference is past its due date
    ├── VerdictNotMet                3    a gate, a limit or an `expect` was not met
    └── WorkFailed                   1    the work failed on the way
        ├── OperatorRefused               the operator said no, or could not
        ├── ArchiveError                  a record could not be kept or does not verify
        ├── BenchUnreachable              the bench or one of its services does not answer
        ├── BenchHeld                     another program has the bench
        ├── NotSafe                       what was energised was not read back as off
        └── InstrumentError               one instrument, with both halves of the exchange
            ├── NoAnswer                  nothing, or too late
            ├── BadReply                  something that is not an answer
            ├── Disconnected              the link is gone
            ├── WrongIdentity             another instrument answers at this address
            ├── SettingRefused            the instrument did not take a setting
            ├── SignalOverload            an input, a decoder or a converter is over its range
            ├── SignalLow                 the vibrometer's optical level is too low to trust
            └── AcquisitionFailed         overflow, channel slip, implausible clock: the record ended early

A message says where, what was found, and what was wanted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


class RigError(Exception):
    """Root of every deliberate error; `exit_code` is what the command line returns."""

    exit_code = 1


class Terminated(BaseException):
    """SIGTERM or SIGHUP: like Ctrl-C it is no error, and unwinds through every safe action. Exit code 130."""


class BadInput(RigError):
    """What the user gave cannot be used; nothing was moved and nothing was sent."""

    exit_code = 2


@dataclass(frozen=True, order=True)
class Problem:
    """One mistake in a file: one-based line and column, the key, and the text `found …, wanted …`."""

    file: str
    line: int
    column: int
    key: str
    text: str

    def __str__(self) -> str:
        key = f" {self.key}:" if self.key else ""
        return f"{self.file}:{self.line}:{self.column}{key} {self.text}"


class ConfigError(BadInput):
    """All mistakes of a YAML file at once, in the order of the file."""

    def __init__(self, problems: Sequence[Problem]) -> None:
        self.problems = tuple(sorted(problems))
        super().__init__("\n".join(str(problem) for problem in self.problems))


class LimitExceeded(BadInput):
    """A point asks for more than the instrument can or the bench may."""


class OperatorMissing(BadInput):
    """A confirmation is needed and nobody can give it; raised before anything is energised."""


class StandardOverdue(BadInput):
    """A reference standard is past its due date and no override was given."""


class VerdictNotMet(RigError):
    """A gate, a limit or an `expect` was not met."""

    exit_code = 3


class WorkFailed(RigError):
    """The work failed on the way."""


class OperatorRefused(WorkFailed):
    """The operator said no, or could not do what was asked."""


class ArchiveError(WorkFailed):
    """A record could not be kept, or does not verify."""


class BenchUnreachable(WorkFailed):
    """The bench or one of its services does not answer."""


class BenchHeld(WorkFailed):
    """Another program has the bench; nothing was sent to it."""


class NotSafe(WorkFailed):
    """Something that was energised on the bench was not read back as off."""


class InstrumentError(WorkFailed):
    """One instrument failed; shows where it is and both halves of the exchange.

    `hp89410a at GPIB0::19::INSTR: sent 'CALC1:DATA?', received 'garbage', wanted a definite-length block`
    """

    def __init__(
        self,
        instrument: str,
        address: str,
        *,
        wanted: str,
        sent: bytes | str | None = None,
        received: bytes | str | None = None,
    ) -> None:
        self.instrument, self.address = instrument, address
        self.sent, self.received, self.wanted = sent, received, wanted
        parts = []
        if sent is not None:
            parts.append(f"sent {_shown(sent)}")
        if received is not None:
            parts.append(f"received {_shown(received)}")
        parts.append(f"wanted {wanted}")
        super().__init__(f"{instrument} at {address}: {', '.join(parts)}")


class NoAnswer(InstrumentError):
    """Nothing came back, or it came too late."""


class BadReply(InstrumentError):
    """Something came back that is not an answer."""


class Disconnected(InstrumentError):
    """The link to the instrument is gone."""


class WrongIdentity(InstrumentError):
    """Another instrument answers at this address."""


class SettingRefused(InstrumentError):
    """The instrument did not take a setting; or the driver refused it and sent nothing."""


class SignalOverload(InstrumentError):
    """An input, a decoder or a converter is over its range."""


class SignalLow(InstrumentError):
    """The vibrometer's optical level is too low to trust."""


class AcquisitionFailed(InstrumentError):
    """Overflow, channel slip, implausible clock: the record ended early, what came before is kept."""


def _shown(data: bytes | str, limit: int = 80) -> str:
    """An exchange as a reader wants it: text in quotes, long data cut with its length."""
    text = data.decode("latin-1") if isinstance(data, bytes) else data
    text = text.rstrip("\r\n")
    if len(text) <= limit:
        return repr(text)
    return f"{text[:limit]!r}… ({len(data)} bytes)"

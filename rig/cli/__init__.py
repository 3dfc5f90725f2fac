"""The command line: the one place where everything meets.

Commands are imported when they are called, so that `rig --help` stays as quick as the shell expects.
"""

from __future__ import annotations

import importlib
import keyword
import os
import sys
from collections.abc import Mapping
from typing import NoReturn

import click

# by section, name: (module that has it, what `rig --help` says)
SECTIONS: Mapping[str, Mapping[str, tuple[str, str]]] = {
    "Measure": {
        "sweep": ("measure", "Drive one axis on the shaker over frequency and level."),
        "turntable": ("measure", "Turn the cube on the platter at 33 1/3 or 45 rpm."),
        "noise": ("measure", "Record everything at rest."),
        "tumble": ("measure", "Record static poses against gravity."),
        "run": ("measure", "Run a procedure from a YAML file."),
        "resume": ("measure", "Go on with an interrupted run."),
    },
    "Look at runs": {
        "runs": ("runs", "List the runs."),
        "show": ("runs", "Show one run."),
        "verify": ("runs", "Check a run's digests, from the journal to the last block."),
    },
    "Conclude": {
        "calibrate": ("calibration", "Calibrate a unit from its runs."),
        "certify": ("calibration", "Certificate of a unit: PDF and digital (DCC)."),
        "report": ("calibration", "A page with the paper's tables and figures, drawn from runs."),
        "export": ("calibration", "Write a calibration for robots and other programs."),
        "compare-calibrations": ("calibration", "Compare two calibrations by En numbers."),
        "qualify": ("qualifying", "Calibrate units by a calibrated one that rode with them."),
    },
    "Bring in other people's data": {
        "import": ("importing", "Make a run out of other people's measurements."),
    },
    "Explain and repair a model": {
        "compare": ("repair", "Error against noise, and where a model fails."),
        "diagnose": ("repair", "Which effect is missing in a model, and why."),
        "add": ("repair", "Add an effect to a model and refit."),
        "remove": ("repair", "Take an effect out of a model and refit."),
        "fit": ("repair", "Fit a model to runs and keep it in its file."),
        "history": ("repair", "The ladder of a model's repair, as table and figure."),
        "effects": ("effects", "The shelf of effects, and the page of each."),
    },
    "Measure what decides": {
        "next": ("investigate", "Which measurement would decide what is still open."),
        "floor": ("investigate", "Measure the bench's own ripple from remounts."),
        "investigate": ("investigate", "Measure, diagnose, and go on until adequate or undecidable."),
        "demo": ("investigate", "A sealed world to learn on: demo hidden."),
    },
    "The bench": {
        "bench": ("bench", "Check the bench, make it safe, serve or reveal it."),
        "daq": ("daq", "The acquisition service on the PC-104 machine."),
        "init": ("init", "Copy example configs and procedures into this folder."),
    },
}
COMMANDS = {name: entry for section in SECTIONS.values() for name, entry in section.items()}
EXIT_CODES: Mapping[int, str] = {
    0: "Done.",
    1: "The work failed on the way: an instrument, the operator, the bench, the archive. The bench has another driver. "
    "NOT SAFE: something that was energised was not read back as off.",
    2: "What you gave cannot be used: options, a YAML file, a missing operator, an overdue standard, an unknown run. "
    "Nothing was energised.",
    3: "A limit, a gate or an `expect` was not met.",
    130: "Interrupted (Ctrl-C, SIGTERM, SIGHUP); what was energised was read back as off.",
    141: "The reader of the output went away.",
}


RUNS = "rig.cli.runs"  # in the invocation's meta: the folder of runs that it is about


class LazyGroup(click.Group):
    """A group whose commands are imported only when they are used."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        module = importlib.import_module(f"rig.cli.{COMMANDS[cmd_name][0]}")
        name = cmd_name.replace("-", "_")
        # `import` is a word of the language's own
        command: click.Command = getattr(module, f"{name}_" if keyword.iskeyword(name) else name)
        return command

    def invoke(self, ctx: click.Context) -> object:
        """Errors leave with the commands that they advise completed, an interruption with what to do next."""
        from rig.errors import RigError, Terminated

        try:
            done = super().invoke(ctx)
        except RigError as error:
            from rig.cli.onward import completed

            error.args = tuple(completed(part) if isinstance(part, str) else part for part in error.args)
            _warn(ctx, error)
            raise
        except (click.Abort, KeyboardInterrupt, Terminated) as stop:
            _say_interrupted(ctx, stop)
            raise click.exceptions.Exit(130) from None
        _warn(ctx)
        return done

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        width = max(map(len, COMMANDS))  # one column for all sections
        for title, commands in SECTIONS.items():
            with formatter.section(title):
                formatter.write_dl([(f"{name:<{width}}", text) for name, (_, text) in commands.items()])

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Exit codes"):
            formatter.write_dl([(str(code), text) for code, text in EXIT_CODES.items()])


def _warn(ctx: click.Context, error: Exception | None = None) -> None:
    """Say what is left armed on a bench, unless the error says so already; commands about runs are not kept from it."""
    from rig.errors import NotSafe

    if RUNS not in ctx.meta or isinstance(error, NotSafe):
        return
    from rig.bench.armed import unattended
    from rig.cli.onward import command

    for armed in unattended(ctx.meta[RUNS]):
        _shout(f"{armed}; next: {command('bench', 'safe')}")


def _shout(text: str) -> None:
    """Red on a terminal."""
    click.secho(f"NOT SAFE: {text}", fg="red", bold=True, err=True)


def _say_interrupted(ctx: click.Context, stop: BaseException) -> None:
    """What to do next, and how the bench was left as far as that was read back."""
    from rig.cli.onward import command

    click.echo("; ".join(["interrupted", *getattr(stop, "__notes__", ())]), err=True)
    found = COMMANDS.get(ctx.invoked_subcommand or "", ("", ""))[0]
    if found in ("measure", "investigate"):
        click.echo(f"next: {command('resume', 'last')}", err=True)
    click.echo(f"next: {command('runs')}", err=True)


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="rig")
def cli() -> None:
    """Calibrate a MEMS inertial unit traceably on a hardware-in-the-loop bench, and explain the sensor.

    Without a bench of your own everything runs on the simulated one. Start with: rig sweep --axis x
    """


def main() -> NoReturn:
    """Entry point: deliberate errors become one message on stderr and the exit code that the error names."""
    from rig.errors import NotSafe, RigError, Terminated

    # the matrices of a fit are small: threads of the linear algebra wait for one another longer than they work
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        code = cli.main(standalone_mode=False)
    except click.exceptions.Exit as stop:
        code = stop.exit_code
    except click.ClickException as error:
        error.show()
        code = error.exit_code
    except (click.Abort, KeyboardInterrupt, Terminated):  # before any command had begun
        click.echo("interrupted", err=True)
        code = 130
    except NotSafe as error:
        if isinstance(error.__cause__, RigError):
            click.echo(f"error: {error.__cause__}", err=True)
        _shout(str(error))
        code = error.exit_code
    except RigError as error:
        click.echo("\n".join([f"error: {error}", *getattr(error, "__notes__", ())]), err=True)
        code = error.exit_code
    except BrokenPipeError:  # the reader of our output (head, less) went away
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = 141
    sys.exit(code if isinstance(code, int) else 0)

"""Entry point of `htcp`: each command is a function in the module of its name, and one line in COMMANDS.

A command's module is imported when it runs. Commands return their exit code. Bad input, on the command line or in a
file, gives one line and code 2.
"""

import contextlib
import errno
import importlib
import importlib.metadata
import logging
import os
import sys
import warnings
from collections.abc import Sequence
from typing import Annotated

import typer
from typer.core import TyperGroup

from htcp_jax.errors import InputError, Interrupted, Lost, Note
from htcp_jax.process_exit import INTERRUPTED as STOPPED

# Suppresses matplotlib's message at import if there is no writable home folder.
logging.getLogger("matplotlib").setLevel(logging.ERROR)

COMMANDS = {
    "plan": "Plan one job: motion, summary, picture.",
    "program": "Time a plan and write it as a robot program.",
    "robot": "Convert a URDF or MJCF model to an arm of capsules.",
    "cell": "Convert a URDF or MJCF model in which the part moves.",
    "sweep": "Plan every scenario of a parameter grid by several methods.",
    "report": "Summarise sweeps in tables and charts.",
    "validate": "Check results independently with MuJoCo.",
    "view": "Show plans in the browser.",
    "render": "Draw a picture and a movie of one plan.",
    "place": "Search for the best mounting of the workpiece or the arm.",
    "reachability": "Bound the number of targets that any method can reach.",
    "gate": "Compare a sweep with a baseline (regression test).",
    "methods": "List the planning methods.",
    "example": "List the examples, or copy one to a folder.",
    "doctor": "Check the installation with a self-test of 2 s.",
}

LOST, UNREAD, BAD_INPUT, INTERRUPTED = 1, 1, 2, 130  # UNREAD: the pipe is closed
FULL = errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO  # errors of a disk, not of this code
COMPLETION = "--install-completion", "--show-completion"
LONGEST = 60  # characters of a file's name in a message


class Commands(TyperGroup):
    """Group of commands that are imported on demand; its help shows only their names and lines in COMMANDS."""

    def resolve_command(self, ctx, args):
        """Import the command that the first argument names; return it with the remaining arguments."""
        name, command, rest = super().resolve_command(ctx, args)
        return name, command and _imported(name), rest


def _imported(name: str):
    function = getattr(importlib.import_module(f"htcp_jax.cli.{name}"), name)
    if "jax" in sys.modules:  # some commands do without
        importlib.import_module("htcp_jax.device.compile_cache").enable()
    alone = typer.Typer(rich_markup_mode=None, pretty_exceptions_enable=False, add_completion=False)
    alone.command(name, short_help=COMMANDS[name])(function)
    return typer.main.get_command(alone)


def _placeholder() -> None:
    """Do nothing; placeholder of a command that is not imported yet."""


HELP = {"help_option_names": ["-h", "--help"]}  # commands inherit them
app = typer.Typer(cls=Commands, rich_markup_mode=None, pretty_exceptions_enable=False, context_settings=HELP)
for _name, _line in COMMANDS.items():
    app.command(_name, short_help=_line)(_placeholder)


def _show_version(requested: bool) -> bool:
    if requested:
        print(f"htcp {importlib.metadata.version('htcp_jax')}")
        raise typer.Exit
    return requested


@app.callback()
def htcp(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    """Plan collision-free motions of a robot arm whose tool follows a path, inside narrow parts.

    \b
    First steps:
      htcp plan                                  plan the default job; the picture is out/plan/plan.png
      htcp plan --method baseline                the same job by another method
      htcp plan pipe --set settings.seed=1       an example with one key changed; htcp example lists them
      htcp example pipe mine                     copy its files as a start for your own job: mine/job.yaml

    \b
    Many plans:
      htcp sweep sweeps/workpiece --methods baseline,hybrid    49 poses of the part, into out/workpiece
      htcp report out/workpiece                  tables and charts: out/report/report.html
      htcp validate out/workpiece                check every tracked target with MuJoCo
      htcp view out/workpiece                    show them in the browser, failed ones first
      htcp render out/workpiece --scenario 24    a picture and a movie of one of them

    \b
    Your own robot:
      htcp robot mine/arm.xml --out mine/capsules.xml    convert its URDF or MJCF model

    \b
    Help:
      htcp methods                               list the planning methods
      htcp doctor                                check the installation
      htcp COMMAND --help                        options and examples of one command
      htcp --install-completion                  install shell completion

    A job is a YAML file with the keys that differ from the default job. Tables go to stdout, progress to stderr.
    --json prints JSON instead of a table. NO_COLOR disables colours. Exit codes: 0 success, 2 bad input, 130 or 143
    ended by a signal; each command lists its own.
    """


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command, or show the help if there is none.

    Args:
        argv: Arguments of the command line without `htcp`; None: those of this process.

    Returns:
        The exit code.
    """
    words = list(sys.argv[1:] if argv is None else argv) or ["--help"]
    try:
        code = _run(words)
        if sys.stdout is not None:
            sys.stdout.flush()  # here, where a full disk can still be reported
        return code
    except InputError as error:
        return _print_refusal(str(error))
    except typer.TyperException as error:
        return _print_refusal(error.format_message())
    except Lost as lost:
        _print_line(str(lost))
        return LOST
    except Interrupted as stop:
        _print_line(str(stop))
        return stop.code
    except BrokenPipeError:
        _forget_stdout()
        return UNREAD
    except OSError as error:
        if error.filename is None and error.errno not in FULL:
            raise
        _forget_stdout()
        return _print_refusal(_system_message(error))


def _run(words: list[str]) -> int:
    """Run the command in `words`; return its exit code."""
    if any("\0" in word for word in words):
        raise InputError("an argument holds a NUL byte; no name of a file does")
    if words[0] in COMPLETION and len(words) > 1:
        os.environ["_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION"] = "1"  # the named shell, not a detected one
    with warnings.catch_warnings():
        warnings.simplefilter("default", UserWarning)
        warnings.showwarning = _warn
        code = app(args=words, prog_name="htcp", standalone_mode=False)
    if code == INTERRUPTED:  # typer's code for Ctrl-C
        _print_line(STOPPED)
    return int(code or 0)


def _system_message(error: OSError) -> str:
    """One-line message on an invalid name, or a full disk."""
    if error.filename is None:
        return f"cannot write the output: {error.strerror}"
    name = os.fsdecode(error.filename) if isinstance(error.filename, str | bytes) else str(error.filename)
    return f"{name if len(name) <= LONGEST else name[:LONGEST] + '...'}: {error.strerror}"


def _forget_stdout() -> None:
    """Discard unwritten output, so that Python does not fail on it again at exit."""
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
    except OSError:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)


def _warn(message: Warning, *_) -> None:
    kind = "note" if isinstance(message, Note) else "warning"
    _print_line(f"{kind}: {message}")


def _print_refusal(reason: str) -> int:
    _print_line(" ".join(reason.split()))
    return BAD_INPUT


def _print_line(line: str) -> None:
    with contextlib.suppress(OSError):  # stderr may be as full as stdout
        print(f"htcp: {line}", file=sys.stderr)

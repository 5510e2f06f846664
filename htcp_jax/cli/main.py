"""Entry point of `htcp`. A command is a function in the module of the same name, with one line in COMMANDS.

A command's module is imported when the command runs. Commands return their exit code. Invalid input, on the command
line or in a file, prints one line and returns 2.
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
from functools import partial
from typing import Annotated

import typer
from typer.core import TyperGroup

from htcp_jax.caching import cache_folder
from htcp_jax.cli.heartbeat import HEARTBEAT
from htcp_jax.errors import InputError, Interrupted, Lost, Note
from htcp_jax.system import INTERRUPTED as STOPPED

# Suppresses the message that matplotlib prints at import if the home folder is not writable.
logging.getLogger("matplotlib").setLevel(logging.ERROR)

COMMANDS = {
    "plan": "Plan one job: motion, summary, picture.",
    "program": "Time a plan and write it as a robot program.",
    "prove": "Prove that the motion in a file of any tool is clear.",
    "robot": "Convert a URDF or MJCF model to an arm of capsules.",
    "cell": "Convert a URDF or MJCF model in which the part moves.",
    "tool": "Convert a torch's mesh, or check the tool of a job.",
    "sweep": "Plan every scenario of a parameter grid by several methods.",
    "report": "Summarise sweeps in tables and charts.",
    "validate": "Check results independently with MuJoCo.",
    "view": "Show plans in the browser.",
    "render": "Draw a picture and a movie of one plan.",
    "place": "Search for the best mounting of the workpiece or the arm.",
    "reachability": "Compute lower and upper bounds on reachable targets.",
    "gate": "Compare a sweep with a baseline (regression test).",
    "methods": "List the planning methods.",
    "example": "List the examples, or copy one to a folder.",
    "prepare": "Compile what the first plan of many jobs waits for.",
    "doctor": "Check the installation with a self-test of 2 s.",
}

# Exit codes. LOST: worker processes or machines are lost; UNREAD: the reader of stdout has closed the pipe
LOST, UNREAD, BAD_INPUT, INTERRUPTED = 1, 1, 2, 130
FULL = errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO  # errors of a full or a faulty disk
COMPLETION = "--install-completion", "--show-completion"
LONGEST = 60  # maximum length of a file name in a message


class Commands(TyperGroup):
    """Group of commands that are imported on demand. Its help text is built from COMMANDS without importing them."""

    def resolve_command(self, ctx, args):
        """Import the command named by the first argument, then call the method of the base class."""
        name, command, rest = super().resolve_command(ctx, args)
        return name, command and _imported(name), rest


def _imported(name: str):
    function = getattr(importlib.import_module(f"htcp_jax.cli.{name}"), name)
    if "jax" in sys.modules:  # some commands do not import JAX
        importlib.import_module("htcp_jax.caching.cache_folder").enable()
        importlib.import_module("htcp_jax.backend").check_platforms()
    alone = typer.Typer(rich_markup_mode=None, pretty_exceptions_enable=False, add_completion=False)
    alone.command(name, short_help=COMMANDS[name])(function)
    return typer.main.get_command(alone)


def _placeholder() -> None:
    """Do nothing. This function is a placeholder for a command that is not imported yet."""


HELP = {"help_option_names": ["-h", "--help"]}  # all commands inherit these options
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
      htcp example pipe mine                     copy an example's files to start your own job: mine/job.yaml

    \b
    Many plans:
      htcp sweep sweeps/workpiece --methods baseline,hybrid    49 poses of the part, into out/workpiece
      htcp report out/workpiece                  tables and charts: out/report/report.html
      htcp validate out/workpiece                check every tracked target with MuJoCo
      htcp view out/workpiece                    show the plans in the browser, failed plans first
      htcp render out/workpiece --scenario 24    draw a picture and a movie of one plan

    \b
    Your own robot:
      htcp robot mine/arm.xml --out mine/capsules.xml    convert a URDF or MJCF model
      htcp tool torch.stl --unit mm --tip 0,0,350 --out torch.xml    convert a torch's mesh

    \b
    Help:
      htcp methods                               list the planning methods
      htcp doctor                                check the installation
      htcp COMMAND --help                        options and examples of one command
      htcp --install-completion                  install shell completion

    A job is a YAML file with the keys that differ from the default job. Tables go to stdout, progress to stderr.
    Pass --json to print JSON instead of a table. Set NO_COLOR to disable colours. Exit codes: 0 success, 2 bad input,
    130 or 143 ended by a signal; the help of each command lists further ones.
    """


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command, or show the help if there is none.

    Args:
        argv: Arguments of the command line without `htcp`; None: the arguments of this process.

    Returns:
        The exit code.
    """
    words = list(sys.argv[1:] if argv is None else argv) or ["--help"]
    try:
        code = _run(words)
        if sys.stdout is not None:
            sys.stdout.flush()  # here, where an error for a full disk can still be reported
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
    """Run the command line with these arguments and return the exit code."""
    if any("\0" in word for word in words):
        raise InputError("an argument contains a NUL byte, which no file name can contain")
    for before, word in zip(["", *words], words, strict=False):
        option, equals, value = word.partition("=") if word.startswith("--") else (before, "=", word)
        if equals and not value.strip():  # the name of a file would become that of the current folder
            what = option if option.startswith("-") else "an argument"
            raise InputError(f"{what} is empty; give a value, or omit it")
    if words[0] in COMPLETION and len(words) > 1:
        os.environ["_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION"] = "1"  # use the shell that the argument names
    with warnings.catch_warnings():
        warnings.simplefilter("default", UserWarning)
        warnings.showwarning = partial(_warn, shown=set())
        with HEARTBEAT.command(words[0]):
            code = app(args=words, prog_name="htcp", standalone_mode=False)
    if code == INTERRUPTED:  # typer's code for Ctrl-C
        _print_line(STOPPED)
    return int(code or 0)


def _system_message(error: OSError) -> str:
    """Return a one-line message for an error of the operating system, such as a missing file or a full disk."""
    if error.filename is None:
        return f"cannot write the output: {error.strerror}"
    name = os.fsdecode(error.filename) if isinstance(error.filename, str | bytes) else str(error.filename)
    return f"{name if len(name) <= LONGEST else name[:LONGEST] + '...'}: {error.strerror}"


def _forget_stdout() -> None:
    """Redirect stdout to the null device if it cannot be written, so that Python does not fail again at exit."""
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
    except OSError:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)


def _warn(message: Warning, *_, shown: set[str]) -> None:
    """Print a warning as one line, and only once. JAX warns of every damaged file in its cache."""
    text = cache_folder.damaged() if str(message).startswith(cache_folder.UNREADABLE) else str(message)
    if text not in shown:
        shown.add(text)
        _print_line(f"{'note' if isinstance(message, Note) else 'warning'}: {text}")


def _print_refusal(reason: str) -> int:
    _print_line(" ".join(reason.split()))
    return BAD_INPUT


def _print_line(line: str) -> None:
    with contextlib.suppress(OSError):  # stderr may be on the same full disk
        print(f"htcp: {line}", file=sys.stderr)

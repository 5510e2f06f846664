"""Speed of this checkout, compared with the committed figures, and in pairs with another checkout.

    python -m benchmarks speed [--against CHECKOUT] [--pairs N] [--only CASE,...] [--quick] [--peers] [--record]

Every run of a case is a separate process that imports the package and the benchmarks of one tree, in this Python's
environment. With --against a case runs alternately here and there, N times each: "ratio" is the ratio of the medians,
"of pairs" the smallest and the largest ratio of a pair. Cases, all on the CPU (for a GPU: python -m benchmarks gpu):

CASES

A row of a table or sweep has a method's time without compilation [s], and its number of tracked targets. It includes
proofs of motions in trees that have them; "engines alone" excludes these and the checks of joint paths, for comparison
with a tree without them. All cases run unless --only names some; peers, which run only here, if their extra is
installed. --quick plans few scenarios by two methods, to test that all cases run.

--config FILE: the section `workpiece` of a job file in place of the generated duct; --against-config FILE if the other
checkout has other keys. --record writes the figures into figures.yaml next to this file: all of them, or none if a case
failed. The machine should be idle.

Exit code: 1 if the counts of the two checkouts differ or a case fails here; 2 on bad input.
"""

import argparse
import hashlib
import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

from benchmarks.figures import COMMITTED, Entry, committed, nearest, record
from benchmarks.speed_cases import CASES, Broken, Checkout, Requested, lacking
from benchmarks.speed_table import Measured, counts_differ, head, medians, rows, sources
from htcp_jax.errors import InputError
from htcp_jax.jobs import load_config
from htcp_jax.planning import registry
from htcp_jax.spec.strict_yaml import read_yaml

ROOT = Path(__file__).resolve().parents[1]
NEEDED = "htcp_jax/__init__.py", "benchmarks/tables.py", "sweeps/cross.yaml", "pyproject.toml"  # of a checkout
OF_NO_FIGURE = ":!*.md", ":!benchmarks/figures.yaml"  # changes there are ignored
FILES = "cloud", "path"  # keys of a workpiece


def main() -> int:
    """Measure, print, record."""
    try:
        requested = _arguments()
        here = Checkout("here", ROOT, part_of(requested.config), tuple(requested.changes))
        load_config(overrides=here.overrides)
        there = _other(requested)
        return measure(requested, here, there)
    except InputError as error:
        print(error, file=sys.stderr)
        return 2


def measure(requested: argparse.Namespace, here: Checkout, there: Checkout | None) -> int:
    """Run all cases one after the other, and print a part of the table for each."""
    facts = json.loads(here.python("-m", "benchmarks.hardware"))
    names, job, machine = cases_to_run(requested), job_of(here.part, requested), facts["machine"]
    known, now = committed(requested.figures), commit(ROOT)
    print(f"{machine}; {facts['versions']}\nhere: {now}")
    if there:
        print(f"there: {commit(there.root)}, {there.root}")
    print(f"{job}\n\n{head(pairs=there is not None)}", flush=True)
    compared, new, notes, wrong = [], [], [], []
    for name in names:
        try:
            found = _alternately(name, here, None if name == "peers" else there, requested, notes)
        except Broken as error:
            wrong.append(f"{name} failed here: {error}")
            continue
        old = nearest(known, name, job, machine)
        print(f"{name}: {CASES[name].about}", *rows(found, old, machine, there is not None), sep="\n", flush=True)
        compared.append((name, found, old))
        wrong += counts_differ(name, found)
        kept = tuple(one._replace(value=float(f"{one.value:.4g}")) for one in medians(found.here).values())
        new.append(Entry(name, job, machine, now, facts["versions"], kept))
    if requested.record:
        notes.append(_recorded(requested.figures, new, names))
    print("", *sources(compared, machine), *notes, *wrong, sep="\n")
    return 1 if wrong else 0


def part_of(file: Path | None) -> dict[str, Any]:
    """Read the section `workpiece` of a job file, with absolute names of files; empty without a file.

    Raises:
        InputError: For a file that cannot be read.
    """
    if file is None:
        return {}
    part = read_yaml(file).get("workpiece")
    if not isinstance(part, dict):
        raise InputError(f"{file}: no section workpiece")
    files = {key: file.resolve().parent / str(part[key]) for key in FILES if key in part}
    return part | {key: str(path) for key, path in files.items() if path.is_file()}


def job_of(part: dict[str, Any], requested: argparse.Namespace) -> str:
    """Describe the job uniquely, files by their contents."""
    words = [name_of(part)]
    words += ["--quick"] * requested.quick + ["--warm"] * requested.warm
    words += [f"--methods {requested.methods}"] if requested.methods else []
    return ", ".join(words + requested.changes)


def name_of(part: dict[str, Any]) -> str:
    """Name a workpiece uniquely, files by their contents."""
    if not part:
        return "generated duct"
    reported = [
        f"{key}={value}".encode() if key not in FILES else _contents(value) for key, value in sorted(part.items())
    ]
    digest = hashlib.sha256(b"\n".join(reported)).hexdigest()
    return f"{Path(part.get('cloud', 'duct')).name} {digest[:8]}"


def _contents(value: str) -> bytes:
    """Contents of a file, or the name of a built-in part."""
    return Path(value).read_bytes() if Path(value).is_file() else value.encode()


def commit(root: Path, *files: str) -> str:
    """Commit of a checkout, with a note if its files, or those named, differ from it."""

    def git(*words: str) -> str:
        return subprocess.run(["git", "-C", root, *words], capture_output=True, text=True).stdout.strip()

    if shutil.which("git") is None:
        return "no commit"
    changed = git("status", "--porcelain", "--", *(files or (".", *OF_NO_FIGURE)))
    return (git("rev-parse", "--short", "HEAD") or "no commit") + (" and changes" if changed else "")


def _alternately(name: str, here: Checkout, there: Checkout | None, requested, notes: list[str]) -> Measured:
    """Run a case alternately here and there.

    Raises:
        Broken: If a run fails here.
    """
    case, how, found = (
        CASES[name].run,
        Requested(requested.quick, requested.methods, requested.warm),
        Measured([], []),
    )
    for _ in range(requested.pairs or (3 if there else 1)):
        found.here.append(case(here, how))
        try:
            found.there.extend([case(there, how)] if there else [])
        except Broken as error:
            notes.append(f"{name} is not compared, it failed there: {error}")
            found.there.clear()
            there = None
    return found


def _recorded(file: Path, new: list[Entry], names: list[str]) -> str:
    """Record the figures, and return a message."""
    if len(new) < len(names):
        return "nothing recorded, as a case failed"
    record(file, new)
    return f"recorded in {file}"


def _arguments() -> argparse.Namespace:
    """Parse the command line.

    Raises:
        InputError: For an unknown case or method, and for a number of pairs below 1.
    """
    about = __doc__.replace("CASES\n", "\n".join(f"    {name:22} {case.about}" for name, case in CASES.items()) + "\n")
    formatter = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser("python -m benchmarks speed", description=about, formatter_class=formatter)
    parser.add_argument("--against", type=Path, metavar="CHECKOUT")
    parser.add_argument("--pairs", type=int, metavar="N", help="runs of a case: 3 with --against, else 1")
    parser.add_argument("--only", type=lambda text: text.split(","), metavar="CASE,...")
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--peers", action="store_true", help="the peers' case, too, with those that are installed")
    parser.add_argument("--methods", metavar="A,B", help="of the tables and the cross sweep")
    parser.add_argument("--warm", action="store_true", help="time each method's second run: its first one also traces")
    parser.add_argument("--config", type=Path, metavar="FILE")
    parser.add_argument("--against-config", type=Path, metavar="FILE")
    parser.add_argument("--set", action="append", default=[], dest="changes", metavar="KEY=VALUE", help="in every job")
    parser.add_argument("--record", action="store_true")
    parser.add_argument("--figures", type=Path, default=COMMITTED, metavar="FILE", help="other than the committed ones")
    requested = parser.parse_args()
    _refuse("--only", "case", requested.only or [], list(CASES))
    _refuse("--methods", "method", (requested.methods or "baseline").split(","), registry.names())
    if requested.pairs is not None and requested.pairs < 1:
        raise InputError(f"--pairs {requested.pairs}: at least 1")
    return requested


def _refuse(option: str, kind: str, given: list[str], valid: list[str]) -> None:
    if unknown := [name for name in given if name not in valid]:
        raise InputError(f"{option} {unknown[0]}: no {kind}; valid: {', '.join(valid)}")


def _other(requested: argparse.Namespace) -> Checkout | None:
    """Return the checkout to compare with; None without one.

    Raises:
        InputError: For a folder that is no checkout.
    """
    if requested.against is None:
        return None
    if lost := [name for name in NEEDED if not (requested.against / name).is_file()]:
        raise InputError(f"--against {requested.against}: no checkout of this project, it has no {lost[0]}")
    part = part_of(requested.against_config or requested.config)
    return Checkout("there", requested.against.resolve(), part, tuple(requested.changes))


def cases_to_run(requested: argparse.Namespace) -> list[str]:
    """Return the cases to run, and print the reason if peers are excluded."""
    names = list(requested.only or CASES)
    if requested.peers and "peers" not in names:
        names.append("peers")
    lost = lacking() if "peers" in names else []
    if lost:
        print(f"peers lack {', '.join(lost)}: pip install -e '.[peers]'", file=sys.stderr)
    left_out = "peers" if lost and not requested.peers and not requested.only else ""
    return [name for name in names if name != left_out]

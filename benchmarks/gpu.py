"""The cross sweep on a GPU, from the shell: this tree compared with another revision, and the record for README.

    python -m benchmarks gpu [--against REVISION | --trees COMMIT=OLD COMMIT=NEW] [--methods A,B] [--scenarios N]
        [--runs N] [--device gpu[:N]|cpu] [--config FILE] [--options=WORDS] [--old-options=WORDS] [--work DIR]
    python -m benchmarks gpu --readme    copy the record's rows into README.md
    python -m benchmarks gpu --check     exit with 1 if the planning code differs from the record's

`htcp sweep sweeps/cross.yaml` runs in turns with the other revision and with this tree: first the paper's six methods
with all proofs, then `beam` without smoothing. The first run of each begins with an empty cache, the next ones find it
full. "planning" is the sum of the methods' times without compilation, "from the shell" the complete command. The other
revision is unpacked from git, nothing is installed; without git, pass two folders by --trees.

The record, benchmarks/gpu.json, is written after each run. Runs of the same code on the same device and job are added
to it, so that the sweeps may be measured by several commands; with --work they share the caches. Trials, which are runs
on a CPU or of few scenarios, are recorded in build/gpu.json, and README never quotes them.

Exit code: 1 if a run fails; 2 on bad input, and without a GPU.
"""

import argparse
import contextlib
import hashlib
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tarfile
import tempfile
import time
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

from benchmarks.speed import ROOT, commit, name_of, part_of
from benchmarks.speed_cases import ON_CPU, SIX, Broken, Checkout
from htcp_jax.caching.cache_key import CORE
from htcp_jax.errors import InputError

RECORD, TRIAL = ROOT / "benchmarks/gpu.json", ROOT / "build/gpu.json"
README = ROOT / "README.md"
OPTIONS = "--set settings.qp=device --shard 8192"
SWEEPS = {  # methods, options, and the words of README
    "six methods": (SIX.split(","), [], "by six methods, all motions proven"),
    "beam unsmoothed": (["beam"], ["--set", "settings.smooth=false"], "by `beam`, without smoothing"),
}
RENAMED = {"beam": "roadmap"}  # names in older revisions
ROW, ABOVE = "| 6,125 scenarios ", "| both tables of the paper"  # how README's rows begin, and the row above them


def main() -> int:
    """Measure, or check the record, or copy its rows."""
    try:
        requested = _arguments()
        if requested.check:
            return check(ROOT, loaded(RECORD))
        if requested.readme:
            page = with_rows(README.read_text(encoding="utf-8"), loaded(RECORD))
            README.write_text(page, encoding="utf-8")
            return 0
        with contextlib.ExitStack() as stack:
            work = requested.work or Path(stack.enter_context(tempfile.TemporaryDirectory()))
            return measure(requested, work.resolve())
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    except Broken as error:
        print(f"failed: {error}", file=sys.stderr)
        return 1


def loaded(file: Path) -> dict[str, Any]:
    """Return the record in a file; empty without one."""
    return json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}


def planning_code(root: Path) -> list[Path]:
    """Return the files of a tree's planning code, those whose digest also names compiled programs."""
    package = root / "htcp_jax"
    return sorted([*package.glob("*.py"), *(file for name in CORE for file in (package / name).rglob("*.py"))])


def digest(root: Path) -> str:
    """Return the digest of a tree's planning code."""
    code = hashlib.sha256()
    for file in planning_code(root):
        code.update(f"{file.relative_to(root).as_posix()} {file.stat().st_size}\n".encode() + file.read_bytes())
    return code.hexdigest()


def check(root: Path, record: dict[str, Any]) -> int:
    """Return 0 if a record describes a tree's planning code; otherwise print a line, and return 1."""
    if record.get("digest") == digest(root):
        return 0
    measured = f"describes {record['here']}, and the planning code has changed" if record else "does not exist"
    print(f"warning: benchmarks/gpu.json {measured}: run python -m benchmarks gpu before a release")
    return 1


def rows(record: dict[str, Any]) -> list[str]:
    """Return README's rows; none for a trial."""
    if record.get("device", "cpu") == "cpu" or record["scenarios"]:
        return []
    hardware = f"{record['device']}, workpiece {record['part']}, commit {record['here']}"
    found = []
    for name, (*_, words) in SWEEPS.items():
        if medians := record["sweeps"].get(name, {}).get("here", {}).get("medians"):
            (_, planning_s), (_, targets), *_, (shell, shell_s) = medians.items()  # with a full cache, if measured
            figures = f"{planning_s:.1f} s for {targets:,.0f} targets; {shell_s:.0f} s {shell}"
            found.append(f"{ROW}of 105 targets {words} | {figures} | {hardware} |")
    return found


def quoted(page: str) -> list[str]:
    """Return a page's rows that name a GPU or describe these sweeps."""
    return [line for line in page.splitlines() if re.match(rf"{re.escape(ROW)}|\|.*\b(GPUs?|[AHB]\d00)\b", line)]


def with_rows(page: str, record: dict[str, Any]) -> str:
    """Return a page with a record's rows in place of its own."""
    own = quoted(page)
    lines = [line for line in page.split("\n") if line not in own]
    above = next(index for index, line in enumerate(lines) if line.startswith(ABOVE))
    return "\n".join([*lines[: above + 1], *rows(record), *lines[above + 1 :]])


class Tree(NamedTuple):
    """One of the two revisions."""

    commit: str
    checkout: Checkout
    options: str  # of htcp sweep
    methods: str  # that it has, as JSON


def measure(requested: argparse.Namespace, work: Path) -> int:
    """Run the sweeps in turns, print their figures and ratios, and record them.

    Raises:
        InputError: Without a GPU, or if there is no other revision.
        Broken: If a run fails.
    """
    part, on_cpu = part_of(requested.config), requested.device == "cpu"
    hardware = json.loads(Checkout("here", ROOT, part).python("-m", "benchmarks.hardware", **ON_CPU if on_cpu else {}))
    if not hardware["gpus"] and not on_cpu:
        raise InputError("JAX finds no GPU here; --device cpu runs a trial on the CPU")
    trees = _trees(requested, work, part)
    facts = {
        "device": "cpu" if on_cpu else f"{requested.device.partition(':')[2] or hardware['gpus']} {hardware['kind']}",
        **{key: hardware[key] for key in ("machine", "versions")},
        "part": name_of(part),
        "scenarios": requested.scenarios,
        "options": {side: tree.options for side, tree in trees.items()},
        **{side: tree.commit for side, tree in trees.items()},
        "digest": digest(trees["here"].checkout.root),
    }
    file = requested.record or (TRIAL if on_cpu or requested.scenarios else RECORD)
    before = loaded(file)
    record = before if before == before | facts else facts | {"sweeps": {}}
    print(f"{facts['machine']}; {facts['versions']}; {facts['part']}")
    print(f"here: {facts['here']}; against: {facts['against']}", flush=True)
    limit = ["--limit", str(requested.scenarios)] if requested.scenarios else []
    for title, (methods, own, _) in SWEEPS.items():
        chosen = [name for name in methods if name in (requested.methods or methods)]
        name = title if chosen == methods else ",".join(chosen)
        for side in [*trees] * (requested.runs if chosen else 0):
            words = [*own, *limit, "--device", requested.device]
            key = digest(trees[side].checkout.root)[:8]
            cache = work / f"cache-{trees[side].commit}-{key}-{name}".replace(" ", "-")
            run = _swept(trees[side], chosen, words, cache, ON_CPU if on_cpu else {})
            _add(record, name, side, run)
            _write(record, file)
            times = f"{sum(run['planning_s'].values()):.1f} s planning, {run['shell_s']:.1f} s from the shell"
            targets = f"{sum(run['tracked'].values()):,} targets"
            print(f"{name}, {side}, {run['cache']} cache: {times}, {targets}", flush=True)
    for name, found in record["sweeps"].items():
        ratios = "; ".join(f"{key} {ratio:.4g}" for key, ratio in found["ratios"].items())
        print(f"{name}, here / against: {ratios}")
    print(f"recorded in {file}")
    return 0


def _swept(tree: Tree, methods: list[str], words: list[str], cache: Path, on: dict[str, str]) -> dict[str, Any]:
    """Run the sweep by a tree's command, and return its figures. A cache is full if a complete run has filled it."""
    is_complete = cache.with_name(f"{cache.name}.complete")
    state = "full" if is_complete.is_file() else "empty"
    if state == "empty":
        shutil.rmtree(cache, ignore_errors=True)
    names = {name: name if f'"{name}"' in tree.methods else RENAMED.get(name, name) for name in methods}
    with tempfile.TemporaryDirectory() as out:
        command = "sweep", "sweeps/cross.yaml", "--methods", ",".join(names.values()), "--json", "--out", f"{out}/run"
        more = *tree.checkout.sets, *words, *shlex.split(tree.options)
        began = time.perf_counter()
        printed = tree.checkout.htcp(*command, *more, HTCP_CACHE=str(cache), **on)
        shell_s = time.perf_counter() - began
    is_complete.touch()
    found = {name: json.loads(printed)["methods"][there] for name, there in names.items()}
    if not any(each["tracked"] for each in found.values()):
        raise Broken(f"{tree.commit}: no target is tracked; does --config have the part's pose?")
    return {
        "cache": state,
        "shell_s": round(shell_s, 2),
        "compile_s": round(sum(each["compile_s"] for each in found.values()), 2),
        "planning_s": {name: round(each["run_s"], 2) for name, each in found.items()},
        "tracked": {name: each["tracked"] for name, each in found.items()},
    }


def _add(record: dict[str, Any], name: str, side: str, run: dict[str, Any]) -> None:
    """Add a run to a record, and update medians and ratios."""
    sweep = record["sweeps"].setdefault(name, {"here": {"runs": []}, "against": {"runs": []}, "ratios": {}})
    runs = sweep[side]["runs"]
    runs.append(run)
    figures = {"planning": [sum(each["planning_s"].values()) for each in runs]}
    figures["targets"] = [sum(each["tracked"].values()) for each in runs]
    for cache in ("empty", "full"):
        figures[f"from the shell, {cache} cache"] = [each["shell_s"] for each in runs if each["cache"] == cache]
    sweep[side]["medians"] = {key: round(median(values), 2) for key, values in figures.items() if values}
    here, there = (sweep[each].get("medians", {}) for each in ("here", "against"))
    sweep["ratios"] = {key: round(here[key] / there[key], 4) for key in here if there.get(key)}


def _write(record: dict[str, Any], file: Path) -> None:
    """Write a record, atomically."""
    file.parent.mkdir(parents=True, exist_ok=True)
    aside = file.with_suffix(".part")
    aside.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    os.replace(aside, file)


def _trees(requested: argparse.Namespace, work: Path, part: dict[str, Any]) -> dict[str, Tree]:
    """Return the other revision and this tree, both with Python's bytecode files.

    Raises:
        InputError: For a revision or folder that does not exist.
    """
    if requested.trees:
        pairs = [text.partition("=")[::2] for text in requested.trees]
    else:
        revision = requested.against or _git("describe", "--tags", "--abbrev=0")
        old = _git("rev-parse", "--short", f"{revision}^{{commit}}") if revision else ""
        if not old:
            reason = f"--against {revision}: no such revision" if revision else "no tag in this repository"
            raise InputError(f"{reason}; pass --against REVISION or, without git, --trees COMMIT=OLD COMMIT=NEW")
        unpacked(old, work / f"tree-{old}")
        pairs = [(old, work / f"tree-{old}"), (commit(ROOT, "htcp_jax", "sweeps", "configs"), ROOT)]
    options = requested.options if requested.old_options is None else requested.old_options, requested.options
    trees = {}
    for side, (name, folder), words in zip(("against", "here"), pairs, options, strict=True):
        if not folder or not (Path(folder) / "sweeps/cross.yaml").is_file():
            raise InputError(f"{name}={folder}: no tree of this project; --trees takes COMMIT=OLD COMMIT=NEW")
        checkout = Checkout(side, Path(folder).resolve(), part)
        checkout.python("-m", "compileall", "-q", "htcp_jax")
        trees[side] = Tree(name, checkout, words, checkout.htcp("methods", "--json", **ON_CPU))
    return trees


def unpacked(revision: str, folder: Path) -> None:
    """Unpack a revision of this repository into a folder."""
    files = subprocess.run(["git", "-C", ROOT, "archive", revision], capture_output=True, check=True).stdout
    with tempfile.TemporaryFile() as archive:
        archive.write(files)
        archive.seek(0)
        tarfile.open(fileobj=archive).extractall(folder, filter="data")


def _git(*words: str) -> str:
    """Return what a git command prints; "" if it fails."""
    if shutil.which("git") is None:
        return ""
    return subprocess.run(["git", "-C", ROOT, *words], capture_output=True, text=True).stdout.strip()


def _arguments() -> argparse.Namespace:
    """Parse the command line.

    Raises:
        InputError: For a method of neither sweep, and for numbers below 1.
    """
    formatter = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser("python -m benchmarks gpu", description=__doc__, formatter_class=formatter)
    parser.add_argument("--against", metavar="REVISION", help="by default the last tag")
    parser.add_argument("--trees", nargs=2, metavar="COMMIT=FOLDER", help="two folders, for machines without git")
    parser.add_argument("--methods", type=lambda text: text.split(","), metavar="A,B", help="by default all seven")
    parser.add_argument("--scenarios", type=int, metavar="N", help="the first N only")
    parser.add_argument("--runs", type=int, default=2, metavar="N", help="of each sweep in each tree")
    parser.add_argument("--device", default="gpu:1", metavar="gpu[:N]|cpu")
    parser.add_argument("--config", type=Path, metavar="FILE", help="its section `workpiece`, not the generated duct")
    parser.add_argument("--options", default=OPTIONS, metavar="WORDS", help=f"of htcp sweep; by default {OPTIONS}")
    parser.add_argument("--old-options", metavar="WORDS", help="of the other revision; by default the same")
    parser.add_argument("--work", type=Path, metavar="DIR", help="keep the other revision and the caches here")
    parser.add_argument("--record", type=Path, metavar="FILE", help="other than benchmarks/gpu.json")
    parser.add_argument("--readme", action="store_true")
    parser.add_argument("--check", action="store_true")
    requested = parser.parse_args()
    valid = [name for methods, *_ in SWEEPS.values() for name in methods]
    if unknown := set(requested.methods or []) - set(valid):
        raise InputError(f"--methods {min(unknown)}: not in these sweeps; valid: {', '.join(valid)}")
    for option in ("runs", "scenarios"):
        if (number := getattr(requested, option)) is not None and number < 1:
            raise InputError(f"--{option} {number}: at least 1")
    return requested

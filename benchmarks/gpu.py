"""The cross sweep on a GPU, from the shell: this tree compared with another revision, and the record that README quotes.

    python -m benchmarks gpu [--against REVISION | --trees COMMIT=OLD COMMIT=NEW] [--methods A,B] [--scenarios N]
        [--runs N] [--device gpu[:N]|cpu] [--config FILE] [--options=WORDS] [--old-options=WORDS] [--work DIR]
    python -m benchmarks gpu --readme    copy the record's rows into README.md and docs/results.md
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
from typing import Any

from benchmarks.speed import ROOT, commit, name_of, part_of
from benchmarks.speed_cases import ON_CPU, SIX, Broken, Checkout
from htcp_jax.caching.cache_key import CORE
from htcp_jax.errors import InputError

RECORD, TRIAL = ROOT / "benchmarks/gpu.json", ROOT / "build/gpu.json"
PAGES = ROOT / "README.md", ROOT / "docs/results.md"
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
            for page in PAGES:
                page.write_text(with_rows(page.read_text(encoding="utf-8"), loaded(RECORD)), encoding="utf-8")
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


def digest(root: Path) -> str:
    """Return the digest of a tree's planning code: the files whose digest also names compiled programs."""
    package = root / "htcp_jax"
    files = [*package.glob("*.py"), *(file for name in CORE for file in (package / name).rglob("*.py"))]
    code = hashlib.sha256()
    for file in sorted(files):
        code.update(f"{file.relative_to(package).as_posix()} {file.stat().st_size}\n".encode() + file.read_bytes())
    return code.hexdigest()


def check(root: Path, record: dict[str, Any]) -> int:
    """Return 0 if a record describes a tree's planning code; otherwise print a line, and return 1."""
    if record.get("digest") == digest(root):
        return 0
    measured = f"describes {record['commit']}, and the planning code has changed" if record else "does not exist"
    print(f"warning: benchmarks/gpu.json {measured}: run python -m benchmarks gpu before a release")
    return 1


def rows(record: dict[str, Any]) -> list[str]:
    """Return README's rows; none for a trial."""
    if record.get("device", "cpu") == "cpu" or record["scenarios"]:
        return []
    hardware = f"{record['device']}, {record['part']}, at {record['commit']}"
    known = [(words, record["sweeps"][name]) for name, (*_, words) in SWEEPS.items() if name in record["sweeps"]]
    found = []
    for words, (medians, runs) in [(words, (each["here"]["medians"], each["here"]["runs"])) for words, each in known]:
        times = [f"{seconds:.0f} s {name}" for name, seconds in medians.items() if name != "planning"]
        figures = f"{medians['planning']:.1f} s for {sum(runs[-1]['tracked'].values()):,} targets; {times[-1]}"
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


def measure(requested: argparse.Namespace, work: Path) -> int:
    """Run the sweeps in turns, print their figures and ratios, and record them.

    Raises:
        InputError: Without a GPU, or if there is no other revision.
        Broken: If a run fails.
    """
    part = part_of(requested.config)
    hardware = json.loads(Checkout("new", ROOT, part).python("-m", "benchmarks.hardware"))
    trial_on_cpu = requested.device == "cpu"
    if not hardware["gpus"] and not trial_on_cpu:
        raise InputError("JAX finds no GPU here; --device cpu runs a trial on the CPU")
    commits, (old, new) = _trees(requested, work, part)
    options = {"old": requested.options if requested.old_options is None else requested.old_options}
    options["new"] = requested.options
    facts = {
        "device": "cpu" if trial_on_cpu else f"{requested.device.partition(':')[2] or hardware['gpus']} x {hardware['kind']}",
        "machine": hardware["machine"],
        "versions": hardware["versions"],
        "part": name_of(part),
        "scenarios": requested.scenarios,
        "options": options,
        "commit": commits["new"],
        "against": commits["old"],
        "digest": digest(new.root),
    }
    file = requested.record or (TRIAL if trial_on_cpu or requested.scenarios else RECORD)
    before = loaded(file)
    record = before if {**before, **facts} == before else facts | {"sweeps": {}}
    print(f"{facts['machine']}; {facts['versions']}\n{commits['new']} compared with {commits['old']}, {facts['part']}")
    for title, (methods, own, _) in SWEEPS.items():
        chosen = [name for name in methods if name in (requested.methods or methods)]
        name = title if chosen == methods else ",".join(chosen)
        for _ in range(requested.runs if chosen else 0):
            for side, tree in (("against", old), ("here", new)):
                words = [*own, *shlex.split(options[tree.name]), "--device", requested.device]
                words += ["--limit", str(requested.scenarios)] if requested.scenarios else []
                cache = work / f"cache-{tree.name}-{commits[tree.name]}-{digest(tree.root)[:8]}-{name}".replace(" ", "-")
                run = _swept(tree, chosen, words, cache, ON_CPU if trial_on_cpu else {})
                _add(record, name, side, run)
                file.parent.mkdir(exist_ok=True)
                file.with_suffix(".part").write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
                os.replace(file.with_suffix(".part"), file)
                print(
                    f"{name}, {commits[tree.name]}, {run['cache']} cache: {sum(run['planning_s'].values()):.1f} s planning, "
                    f"{run['shell_s']:.1f} s from the shell, {sum(run['tracked'].values()):,} targets tracked",
                    flush=True,
                )
    for name, found in record["sweeps"].items():
        print(f"{name}, ratios: {', '.join(f'{key} {ratio:.2f}' for key, ratio in found['ratios'].items())}")
    print(f"recorded in {file}")
    return 0


def _swept(tree: Checkout, methods: list[str], words: list[str], cache: Path, on: dict[str, str]) -> dict[str, Any]:
    """Run the sweep by a tree's command, and return its figures; a cache is full if it was kept by a complete run."""
    full = cache.with_name(f"{cache.name}.full")
    if is_full := full.is_file():
        pass
    else:
        shutil.rmtree(cache, ignore_errors=True)
    listed = tree.htcp("methods", "--json", **ON_CPU)
    names = {name: name if f'"{name}"' in listed else RENAMED.get(name, name) for name in methods}
    with tempfile.TemporaryDirectory() as out:
        command = "sweep", "sweeps/cross.yaml", "--methods", ",".join(names.values()), "--json", "--out", f"{out}/run"
        began = time.perf_counter()
        printed = tree.htcp(*command, *tree.sets, *words, HTCP_CACHE=str(cache), **on)
        shell_s = time.perf_counter() - began
    full.touch()
    found = {name: json.loads(printed)["methods"][there] for name, there in names.items()}
    return {
        "cache": "full" if is_full else "empty",
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
    times = {"planning": [sum(each["planning_s"].values()) for each in runs]}
    for cache in ("empty", "full"):
        times[f"from the shell, {cache} cache"] = [each["shell_s"] for each in runs if each["cache"] == cache]
    sweep[side]["medians"] = {key: round(median(seconds), 2) for key, seconds in times.items() if seconds}
    here, there = (sweep[each].get("medians", {}) for each in ("here", "against"))
    sweep["ratios"] = {key: round(here[key] / there[key], 3) for key in here if there.get(key)}


def _trees(requested: argparse.Namespace, work: Path, part: dict[str, Any]) -> tuple[dict[str, str], list[Checkout]]:
    """Return the commits of the other revision and of this tree, and their checkouts, compiled to bytecode.

    Raises:
        InputError: For a revision or folder that does not exist.
    """
    if requested.trees:
        pairs = [text.partition("=")[::2] for text in requested.trees]
    else:
        revision = requested.against or _git("describe", "--tags", "--abbrev=0")
        old = _git("rev-parse", "--short", f"{revision}^{{commit}}") if revision else ""
        if not old:
            missing = f"--against {revision}: no such revision" if revision else "no tag is in this repository"
            raise InputError(f"{missing}; pass --against REVISION, or --trees COMMIT=OLD COMMIT=NEW without git")
        unpacked(old, work / f"tree-{old}")
        pairs = [(old, work / f"tree-{old}"), (commit(ROOT), ROOT)]
    trees = [Checkout(name, Path(folder).resolve(), part) for name, (_, folder) in zip(("old", "new"), pairs, strict=True)]
    for tree in trees:
        if not (tree.root / "sweeps/cross.yaml").is_file():
            raise InputError(f"{tree.root}: no tree of this project; --trees takes COMMIT=OLD COMMIT=NEW")
        tree.python("-m", "compileall", "-q", "htcp_jax")
    return {tree.name: named for tree, (named, _) in zip(trees, pairs, strict=True)}, trees


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
    parser.add_argument("--config", type=Path, metavar="FILE", help="section `workpiece` in place of the generated duct")
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

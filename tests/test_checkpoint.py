"""A reachability search that is interrupted: what is finished is kept, not computed again, and the files are the same.

Searches by the toy arm for all targets of six starts, with and without `--each`.
"""

import json
import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import toy
from rich.progress import Progress
from sweep_process import environment, without_progress

from htcp_jax.cli import main
from htcp_jax.errors import Interrupted, Note
from htcp_jax.jobs import load_sweep
from htcp_jax.report.reach_study import search_batch
from htcp_jax.runs.checkpoint import FOLDER, RESULTS, SEARCH, Checkpoint, checkpoint, search_identity
from htcp_jax.runs.reachability_file import REACHABILITY, read_reachability
from htcp_jax.runs.sweep import sweep

OPTIONS = {"resolution_rad": 0.9, "proof_cells": 64}
WORDS = ["reachability", "grid.yaml", "--resolution", "0.9", "--proof-cells", "64", "--out"]
FAR = [2.5, 0.0, 0.3]  # out of reach
# Writes every result at once, so that a process which is killed early has something to lose.
EAGER = """
import sys
from htcp_jax.cli import main
from htcp_jax.runs import checkpoint
from htcp_jax.system import process_exit
checkpoint.EVERY_S = 0.0
process_exit.run(lambda: main(sys.argv[1:]))
"""


def make(folder: Path) -> Path:
    """Write a sweep whose path has a target out of reach, so that there are searches, proofs and gaps."""
    toy.write_sweep(folder)
    path = np.loadtxt(folder / "path.csv", delimiter=",")
    np.savetxt(folder / "path.csv", np.insert(path, 2, FAR, axis=0), delimiter=",")
    return folder


@pytest.fixture
def here(tmp_path, monkeypatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return make(tmp_path)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory) -> dict[str, bytes]:
    """Files of searches that were not interrupted, by folder and name."""
    folder = make(tmp_path_factory.mktemp("undisturbed"))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert main([*WORDS, "each", "--each"]) == main([*WORDS, "bounds"]) == 0
    return {str(file.relative_to(folder)): file.read_bytes() for file in folder.glob("*/*") if file.is_file()}


def files(out: Path, name: str = "each") -> dict[str, bytes]:
    return {f"{name}/{file.relative_to(out)}": file.read_bytes() for file in out.rglob("*") if file.is_file()}


def of(undisturbed: dict[str, bytes], name: str) -> dict[str, bytes]:
    return {file: data for file, data in undisturbed.items() if file.startswith(f"{name}/")}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Result of a search that was not interrupted, and what it computed."""
    folder = make(tmp_path_factory.mktemp("whole"))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        return search(folder / "a")


class Interrupting:
    """A memo that logs what is computed, and presses Ctrl-C before a given number of calls."""

    def __init__(self, memo, after: int | None = None):
        self.memo, self.left, self.computed = memo, after, []

    def __call__(self, step, pairs, width, compute):
        def logged(which):
            if self.left is not None:
                self.left -= 1
                if self.left < 0:
                    raise KeyboardInterrupt
            self.computed += [(step, *pair) for pair in pairs[which].tolist()]
            return compute(which)

        return self.memo(step, pairs, width, logged)


def search(out: Path, after: int | None = None, limit: int | None = None, each: bool = True):
    """Search in a folder, with Ctrl-C before the call number `after`; return the result and what was computed."""
    spec = load_sweep("grid.yaml")
    batch = spec.batch(limit)
    with checkpoint(out, search_identity(spec, **OPTIONS), batch.scenarios.count) as kept:
        memo = Interrupting(kept, after)
        return search_batch(batch, 0.9, 64, each, lambda *now: None, memo), memo.computed


def interrupted(out: Path, after: int, **how) -> set[tuple]:
    """Interrupt a search, and return the step, scenario and target of what it kept."""
    with pytest.raises(Interrupted, match="run the same command to resume"):
        search(out, after, **how)
    return set(Checkpoint(out / FOLDER, np.array([1]))._kept)


@pytest.mark.parametrize("after", [3, 9, 20])
def test_what_is_kept_is_not_computed_again_and_all_else_is(here, whole, after):
    expected, all_ = whole
    kept = interrupted(here / "b", after)
    found, computed = search(here / "b")
    assert kept and set(computed) == set(all_) - kept
    for a, b in zip((*expected[:-1], *expected.each), (*found[:-1], *found.each), strict=True):
        np.testing.assert_array_equal(a, b)
    assert not any((here / "b").iterdir())


def test_each_and_a_larger_limit_may_be_added(here, whole):
    expected, all_ = whole
    kept = interrupted(here / "b", 6, limit=2, each=False)
    found, computed = search(here / "b")
    assert kept and set(computed) == set(all_) - kept
    np.testing.assert_array_equal(found.each.reach, expected.each.reach)
    np.testing.assert_array_equal(found.x, expected.x)


def start(out: str, *more: str) -> subprocess.Popen:
    words, pipe = [sys.executable, "-c", EAGER, *WORDS, out, *more], subprocess.PIPE
    return subprocess.Popen(words, env=environment(), stdout=pipe, stderr=pipe, text=True)


@pytest.mark.parametrize(
    ("name", "signals"), [("each", (signal.SIGINT, signal.SIGKILL)), ("bounds", (signal.SIGKILL, signal.SIGINT))]
)
def test_a_command_killed_again_and_again_comes_to_the_same_bytes(here, undisturbed, name, signals):
    more = ["--each"] if name == "each" else []
    kept = partial((here / "out" / FOLDER).glob, RESULTS)
    for least, number in zip((1, 6), signals, strict=True):
        wanted = max(least, len(list(kept())) + 1)  # not earlier, as the command must have installed its handlers
        with start("out", *more) as process:
            while process.poll() is None and len(list(kept())) < wanted:
                time.sleep(0.002)
            process.send_signal(number)
            errors = process.communicate()[1]
        if process.returncode == 0:  # it ended before
            break
        assert process.returncode == (-number if number == signal.SIGKILL else 128 + number)
        if number == signal.SIGINT:
            (line,) = without_progress(errors)
            assert line.startswith("htcp: stopped; results at ") and line.endswith("; run the same command to resume")
    assert main([*WORDS, "out", *more]) == 0
    assert files(here / "out", name) == of(undisturbed, name)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (["--resolution", "0.8"], "resolution_rad was 0.9, now 0.8"),
        (["--proof-cells", "65"], "proof_cells was 64, now 65"),
        (["--seed", "3"], "settings.seed was 0, now 3"),
        ("job.yaml", "workpiece.shift_m was"),
        ("arm.xml", "robot.model was arm.xml, SHA-256"),
        ("path.csv", "workpiece.path was path.csv, SHA-256"),
        ("grid.yaml", "its grid differs"),
    ],
)
def test_another_search_is_refused_in_one_line_and_changes_nothing(here, capsys, change, says):
    interrupted(here / "out", 9)
    before, words = files(here / "out"), [*WORDS, "out"]
    if isinstance(change, list):
        words += change
    else:
        text = (here / change).read_text()
        (here / change).write_text(text.replace("0.45", "0.44") if change == "job.yaml" else _changed(text))
    assert main(words) == 2
    line = capsys.readouterr().err
    assert line.startswith(f"htcp: out/{FOLDER} contains another search, which is not finished: {says}")
    assert line.endswith("; delete the folder, or choose another --out\n") and line.count("\n") == 1
    assert files(here / "out") == before


def _changed(text: str) -> str:
    for was, now in (("-0.1", "-0.2"), ('size="0.03"', 'size="0.031"'), ("2.5", "2.6")):
        text = text.replace(was, now, 1) if was in text else text
    return text


def test_a_second_command_is_refused_while_the_first_runs(here, capsys):
    spec = load_sweep("grid.yaml")
    batch = spec.batch()
    with checkpoint(here / "out", search_identity(spec, **OPTIONS), batch.scenarios.count):
        assert main([*WORDS, "out"]) == 2
    assert capsys.readouterr().err.startswith(f"htcp: out/{FOLDER} is in use by another command: process {os.getpid()}")


def test_damaged_results_are_reported_and_computed_again(here, undisturbed, capsys):
    interrupted(here / "out", 9)
    (file,) = (here / "out" / FOLDER).glob(RESULTS)
    file.write_bytes(file.read_bytes()[:-9])
    assert main([*WORDS, "out", "--each"]) == 0
    assert f"out/{FOLDER}/{file.name} is damaged: " in capsys.readouterr().err
    assert files(here / "out") == of(undisturbed, "each")


@pytest.mark.parametrize(
    ("name", "data", "says"),
    [(SEARCH, b"[1", "is damaged: "), (SEARCH, b"[]", "is damaged: "), (SEARCH, None, f"results without {SEARCH}")],
)
def test_results_whose_search_is_not_known_are_refused(here, capsys, name, data, says):
    interrupted(here / "out", 9)
    file = here / "out" / FOLDER / name
    file.unlink() if data is None else file.write_bytes(data)
    assert main([*WORDS, "out"]) == 2
    line = capsys.readouterr().err
    assert says in line and line.count("\n") == 1 and "delete " in line


def test_progress_says_how_much_was_kept(here, monkeypatch):
    interrupted(here / "out", 9)
    said, add_task = [], Progress.add_task
    monkeypatch.setattr(
        Progress, "add_task", lambda bars, what, **how: said.append(what) or add_task(bars, what, **how)
    )
    assert main([*WORDS, "out"]) == 0
    (words,) = said
    assert words.startswith("targets (") and words.endswith(" of 54 targets kept)")


def test_bounds_that_an_older_version_marked_as_incomplete_are_not_used(here):
    run = sweep("grid.yaml", "baseline", here / "run")
    assert main([*WORDS, "run"]) == 0 and read_reachability(run).prefix.sum() > 0
    file = here / "run" / REACHABILITY
    file.write_text(json.dumps({"complete": False} | json.loads(file.read_text())))
    with pytest.warns(Note, match="is incomplete and not used; run htcp reachability again"):
        assert read_reachability(run) is None

"""Fault tolerance of sweeps: a resumed sweep gives the same bytes as an undisturbed one.

The faults are real: signals, kill -9, a full and a read-only disk, a second sweep on the same folder. For faults of Ray
see test_sweep_ray.py.
"""

import dataclasses
import random
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
import toy
from sweep_process import COLD, HALF, SHARDS, plan_half, rows, start, wait_for_work, without_progress

from htcp_jax.errors import InputError
from htcp_jax.jobs.grid import load_sweep
from htcp_jax.motion import Problem
from htcp_jax.planning import batch
from htcp_jax.runs import open_run
from htcp_jax.runs.manifest import MANIFEST
from htcp_jax.runs.summary import summarise
from htcp_jax.runs.sweep import sweep
from htcp_jax.status import Status

KILLS = 20


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory) -> dict[str, bytes]:
    """Row files of an undisturbed sweep."""
    folder = tmp_path_factory.mktemp("undisturbed")
    toy.write_sweep(folder)
    return rows(sweep(folder / "grid.yaml", "baseline", folder / "run", shard_scenarios=1).folder)


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    toy.write_sweep(tmp_path)
    return tmp_path


def wait_for_rows(process: subprocess.Popen, folder: Path, count: int) -> None:
    """Wait until the run folder has `count` row files, or the sweep has ended."""
    while process.poll() is None and len(list(folder.glob("*/*.parquet"))) < count:
        time.sleep(0.002)


@pytest.mark.slow
def test_a_second_sweep_is_refused_and_a_signal_ends_the_first_which_then_goes_on(here, undisturbed):
    plan_half(here, "run")
    with start(here, "run", **COLD) as first:
        wait_for_work(first, here / "run")
        first.send_signal(signal.SIGSTOP)
        with pytest.raises(InputError, match=f"run is in use by another command: process {first.pid} on "):
            sweep("grid.yaml", "baseline", "run")
        first.send_signal(signal.SIGTERM)
        first.send_signal(signal.SIGCONT)
        output, errors = first.communicate()
    assert (first.returncode, output) == (143, "")
    assert without_progress(errors) == [
        f"htcp: stopped; {HALF} of {SHARDS} plans are finished in run; run the same command to resume"
    ]
    goes_on_to(here, "run", undisturbed)


@pytest.mark.slow
def test_a_signal_before_anything_is_finished_leaves_nothing(here):
    with start(here, "run", **COLD) as first:
        while not (here / "run" / MANIFEST).exists():
            assert first.poll() is None, first.communicate()
            time.sleep(0.01)
        first.send_signal(signal.SIGTERM)
        _, errors = first.communicate()
    assert first.returncode == 143 and "htcp: stopped before anything was finished; nothing was written" in errors
    assert not (here / "run").exists()


def killed_somewhere(here: Path, out: str, draw: random.Random) -> None:
    """Start the sweep into `out` and kill it a random time after a random number of files is written."""
    with start(here, out) as process:
        wait_for_rows(process, here / out, draw.randrange(2 * SHARDS))
        time.sleep(draw.uniform(0.0, 0.05))
        process.kill()
    assert process.returncode in (-signal.SIGKILL, 0)  # 0: it ended before


def goes_on_to(here: Path, out: str, undisturbed: dict[str, bytes]) -> None:
    """Check that the same sweep, called again, completes with the same bytes."""
    run = sweep(here / "grid.yaml", "baseline", here / out, shard_scenarios=1)
    assert run.complete and rows(run.folder) == undisturbed
    assert not list(run.folder.glob(".part-*"))
    assert run.scenarios().num_rows == SHARDS


def test_a_driver_killed_at_a_random_moment_goes_on_to_the_same_bytes(here, undisturbed):
    killed_somewhere(here, "run", random.Random(0))
    goes_on_to(here, "run", undisturbed)


@pytest.mark.slow
def test_drivers_killed_at_20_random_moments_go_on_to_the_same_bytes(here, undisturbed):
    draw = random.Random(1)
    shards = []
    for kill in range(KILLS):
        killed_somewhere(here, f"run{kill}", draw)
        manifest = here / f"run{kill}" / "manifest.json"
        shards.append(len(open_run(manifest.parent).manifest.shards) if manifest.exists() else 0)
        goes_on_to(here, f"run{kill}", undisturbed)
    assert len(set(shards)) > 1, f"the kills all came at the same stage: {shards}"


@pytest.mark.slow
def test_one_sweep_killed_again_and_again_completes_to_the_same_bytes(here, undisturbed):
    draw = random.Random(2)
    for _ in range(5):
        killed_somewhere(here, "run", draw)
    goes_on_to(here, "run", undisturbed)


# The disk


def mount(*words: str) -> None:
    done = subprocess.run(["mount", *words], capture_output=True, text=True)
    if done.returncode:
        pytest.skip(f"needs to mount a file system: {done.stderr.strip()}")


@pytest.fixture
def mounted(here):
    """Empty folder as a mount point."""
    folder = here / "disk"
    folder.mkdir()
    yield folder
    subprocess.run(["umount", str(folder)], capture_output=True)


@pytest.mark.parametrize("kilobytes", [4, 16, 40, 80])
def test_on_a_full_disk_a_sweep_keeps_what_is_finished_and_goes_on_when_there_is_room(mounted, undisturbed, kilobytes):
    mount("-t", "tmpfs", "-o", f"size={kilobytes}k", "none", str(mounted))
    with pytest.raises(InputError, match=r"cannot write to .*run: No space left on device"):
        sweep("grid.yaml", "baseline", mounted / "run", shard_scenarios=1)
    if (mounted / "run" / "manifest.json").exists():
        kept = open_run(mounted / "run")
        assert len(kept.manifest.shards) < SHARDS
        assert not kept.manifest.shards or kept.targets().num_rows == 8 * len(kept.manifest.shards)
    mount("-o", "remount,size=10m", str(mounted))
    goes_on_to(Path.cwd(), "disk/run", undisturbed)


def test_on_a_read_only_disk_a_sweep_writes_nothing_and_a_finished_run_is_read(mounted):
    sweep("grid.yaml", "baseline", mounted / "run", shard_scenarios=1)
    mount("--bind", str(mounted), str(mounted))
    mount("-o", "remount,ro,bind", str(mounted))
    for out in ("run", "other"):
        with pytest.raises(InputError, match=f"cannot write to .*{out}: Read-only file system"):
            sweep("grid.yaml", "baseline", mounted / out)
    assert open_run(mounted / "run").scenarios().num_rows == SHARDS


# One failing scenario in a batch


def test_a_scenario_that_is_not_a_number_fails_and_the_others_are_as_without_it(here):
    """A margin of 1e300 m, which no job file may request, overflows the step QPs of its own scenario only."""
    requested = load_sweep({"config": "job.yaml", "grid": [{"margin_m": [0, 0.0001, 0.0002]}]}).batch()
    odd = dataclasses.replace(requested.scenarios, margin_m=np.array([0.0, 1e300, 0.0002]))
    good, bad = (
        batch.plan(Problem.of(requested.robot, requested.workpiece, each, toy.SETTINGS), "baseline")
        for each in (requested.scenarios, odd)
    )
    for name in ("status", "x", "clearance", "residual", "iterations", "path_clear"):
        before, after = getattr(good, name), getattr(bad, name)
        np.testing.assert_array_equal(after[[0, 2]], before[[0, 2]], err_msg=name)
    (failure,) = (each for each in summarise(bad).failures if each.scenario == 1)
    assert failure.status in (Status.QP_FAILED, Status.QP_INFEASIBLE)

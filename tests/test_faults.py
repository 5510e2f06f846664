"""What may befall a sweep from outside, for real: signals, kill -9, a full and a read-only disk, a second sweep on its
folder. Continuing always gives the bytes of an undisturbed run. Ray's faults are in test_sweep_ray.py."""

import random
import signal
import subprocess
import time
from pathlib import Path

import pytest
from sweep_process import SHARDS, make_sweep, rows, start

from htcp_jax.errors import InputError
from htcp_jax.run_folder import open_run
from htcp_jax.sweep import sweep

KILLS = 20


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory) -> dict[str, bytes]:
    """The row files of a sweep that nothing befell."""
    folder = tmp_path_factory.mktemp("undisturbed")
    make_sweep(folder)
    return rows(sweep(folder / "grid.yaml", "baseline", folder / "run", shard_scenarios=1).folder)


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    make_sweep(tmp_path)
    return tmp_path


def wait_for_rows(process: subprocess.Popen, folder: Path, count: int) -> None:
    """Until the run folder holds so many row files, or the sweep has ended."""
    while process.poll() is None and len(list(folder.glob("*/*.parquet"))) < count:
        time.sleep(0.002)


def test_a_second_sweep_is_refused_and_a_signal_ends_the_first_which_then_goes_on(here, undisturbed):
    with start(here, "run") as first:
        wait_for_rows(first, here / "run", 1)
        first.send_signal(signal.SIGSTOP)  # so that it is still at it
        with pytest.raises(InputError, match=f"run is in use by another sweep: process {first.pid} on "):
            sweep("grid.yaml", "baseline", "run")
        first.send_signal(signal.SIGTERM)
        first.send_signal(signal.SIGCONT)
        output, errors = first.communicate()
    assert (first.returncode, output) == (143, "")
    count = len(open_run("run").manifest.shards)
    lines = errors.strip().splitlines()
    assert lines[0] == "stopping after the step at hand; once more to stop at once"
    assert count < SHARDS and len(lines) == 2
    assert lines[1] in (
        f"htcp: stopped; {count} of {SHARDS} shards are finished in run; the same command goes on from there",
        "htcp: stopped before anything was finished; nothing was written",
    )
    goes_on_to(here, "run", undisturbed)


def killed_somewhere(here: Path, out: str, draw: random.Random) -> None:
    """Begin the sweep into `out` and kill it: a random time after a random number of files is written."""
    with start(here, out) as process:
        wait_for_rows(process, here / out, draw.randrange(2 * SHARDS))
        time.sleep(draw.uniform(0.0, 0.05))
        process.kill()
    assert process.returncode in (-signal.SIGKILL, 0)  # 0: it was done already


def goes_on_to(here: Path, out: str, undisturbed: dict[str, bytes]) -> None:
    """The same sweep, called again, completes to the same bytes."""
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
    assert len(set(shards)) > 3, f"the kills all came at the same stage: {shards}"


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
    """An empty folder to mount something on."""
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
        assert not kept.manifest.shards or kept.targets().num_rows == 13 * len(kept.manifest.shards)
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


# One scenario among others


def test_a_scenario_that_is_not_a_number_fails_and_the_others_are_as_without_it(here):
    """A margin of 1e300 m overflows the step QP of its own scenario."""
    (here / "good.yaml").write_text("config: job.yaml\ngrid: [margin_m: [0, 0.0001, 0.0002]]\n")
    (here / "odd.yaml").write_text("config: job.yaml\ngrid: [margin_m: [0, 1.0e+300, 0.0002]]\n")
    good, odd = (sweep(f"{name}.yaml", "baseline") for name in ("good", "odd"))
    for name in ("targets", "scenarios"):
        tables = [getattr(run, name)() for run in (good, odd)]
        kept = [table.filter([number != 1 for number in table["scenario"].to_pylist()]) for table in tables]
        assert kept[0].equals(kept[1])
    assert odd.scenarios()["failure"].to_pylist()[1] in ("QP_FAILED", "QP_INFEASIBLE")

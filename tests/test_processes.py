"""Planning in several processes: the same plans bitwise, progress meanwhile, and no workers left at the end."""

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest
import toy

import htcp_jax
from htcp_jax.caching import cache_folder
from htcp_jax.device import processes
from htcp_jax.device.processes import portable, profitable_count, shares
from htcp_jax.errors import InputError, Lost
from htcp_jax.model.scenario import stack
from htcp_jax.planning import Method
from htcp_jax.planning.registry import METHODS
from htcp_jax.status import Status

pytestmark = pytest.mark.skipif(jax.default_backend() != "cpu", reason="GPUs are not shared out among processes")
ROOT = Path(__file__).parents[1]
has_proc = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="the processes are not listed in /proc")


def scenarios():
    """Five scenarios, the third of which is refused before planning."""
    made = stack(toy.scenarios())
    made.refused[2] = Status.HOME_IN_COLLISION
    return made


def workers(parent):
    """Process numbers of the workers that a process has started."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(FileNotFoundError, ProcessLookupError):
            started_by = int(stat.read_text().rpartition(")")[2].split()[1])
            if started_by == parent and b"popen_loky" in (stat.parent / "cmdline").read_bytes():
                found.append(int(stat.parent.name))
    return found


def same(a, b):
    for name, array in a.arrays().items():
        np.testing.assert_array_equal(array, b.arrays()[name], err_msg=name)
    for one, other in zip(a.via_points, b.via_points, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("count", [2, pytest.param(3, marks=pytest.mark.slow)])
@pytest.mark.parametrize("method", ["cspace-sample", "beam"])
def test_the_number_of_processes_has_no_influence(count, method):
    """All arrays and via points, bitwise the same as in one process, with one engine or with two."""
    here = toy.planned(scenarios(), method, threads=2)
    same(here, toy.planned(scenarios(), method, processes=count))
    assert here.tracked.any() and bool(len(here.via_points.scenario)) == (method == "beam")


def again(progress=None, times=1):
    """Plan so many copies of the scenarios in two processes."""
    return toy.planned(toy.scenarios() * times, "baseline", progress=progress, processes=2)


def test_progress_counts_what_all_processes_have_done():
    heard = []
    plans = again(heard.append)
    last = heard[-1]
    assert last.scenarios_done == last.scenarios == len(toy.scenarios())
    assert last.targets == sum(int(one.count) for one in toy.scenarios())
    assert last.targets_tracked == plans.tracked.sum() > 0
    for field in ("scenarios_done", "targets_tracked"):
        counts = [getattr(now, field) for now in heard]
        assert counts == sorted(counts)


def test_what_a_worker_raises_arrives():
    with pytest.raises(InputError, match="'nonsense' is not a QP solver; valid: auto, clarabel"):
        toy.planned(method="baseline", settings=replace(toy.SETTINGS, qp="nonsense"), processes=2)


@has_proc
def test_what_progress_raises_ends_the_work_and_a_killed_worker_is_reported_and_the_next_plan_begins_anew():
    """Error in the progress, then killed workers: an error at once, and each time the next call has new workers."""

    def stop(now):
        raise ArithmeticError("enough")

    def kill(now):
        if now.targets_tracked:  # the new workers plan
            for worker in workers(os.getpid()):
                with contextlib.suppress(ProcessLookupError):  # when one has ended, loky ends the others
                    os.kill(worker, signal.SIGKILL)

    with pytest.raises(ArithmeticError, match="enough"):
        again(progress=stop)
    with pytest.raises(Lost, match="a worker process was killed"):
        again(progress=kill, times=400)
    assert again().tracked.any()


class Here(Method):
    """A planner that no other process can have."""

    name, title, description = "here", "Here", "says which process has planned"
    seen = ()

    def plan(self, problem):
        Here.seen = (*Here.seen, os.getpid())
        plans = problem.empty_plans()
        plans.status[problem.to_plan, 0] = Status.NO_SOLUTION
        return plans


def test_a_method_of_this_process_plans_here():
    htcp_jax.register(Here())
    try:
        toy.planned(method="here", processes=2)
    finally:
        METHODS._own.pop("here")
    assert Here.seen == (os.getpid(),)


def test_workers_with_different_variables_plan_the_parts_in_turn():
    """As on several GPUs: each worker sees its own one. The next call has the same workers."""
    workers = [processes.ON_CPU | {"SEEN": name} for name in "ab"]

    def call(notify, first, part):
        notify(1, 1, 1)
        return os.environ["SEEN"], first + part, os.getpid()

    found = [processes.spread(workers, call, portable(40), [0, 1, 2], None).results for _ in range(2)]
    assert [each[:2] for each in found[0]] == [("a", 40), ("b", 41), ("a", 42)] and found[0] == found[1]
    assert len({pid for *_, pid in found[0]}) == 2


def test_few_scenarios_need_no_worker_and_many_do():
    assert profitable_count(64, 1, 10**6) == profitable_count(64, 15, 10**6) == profitable_count(1, 1000, 10**6) == 1
    assert profitable_count(2, 49, 5145) == 1 and profitable_count(2, 49, 10290) == 2
    assert profitable_count(64, 125, 13125) == 15  # at least eight scenarios each


def test_the_number_of_processes_does_not_depend_on_earlier_calls():
    assert {profitable_count(2, 49, 5145) for _ in range(10)} == {1}


SCRIPT = """
import time
import numpy as np, toy
from htcp_jax.device.processes import portable

class Mine:
    pass

def hear(now):
    print("plans", flush=True)
    time.sleep(600)

print(portable(np.zeros(2)) is not None, portable(Mine()) is None, portable(lambda: 0) is None)
print(toy.planned(method="baseline", processes=2).tracked.sum(), flush=True)
toy.planned(method="baseline", processes=2, progress=hear)
"""


@has_proc
def test_a_script_needs_no_guard_and_its_workers_end_with_it():
    """Plan in a script from standard input, like the cells of a notebook: it runs once, not in the workers, too.

    What other processes cannot import is not sent to them. The workers end after their parent process, also if it is
    killed.
    """
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])}
    piped = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen([sys.executable, "-"], env=environment, **piped) as running:
        running.stdin.write(SCRIPT)
        running.stdin.close()
        lines = [running.stdout.readline().split() for _ in range(3)]
        started = workers(running.pid)
        running.kill()
    tracked = toy.planned(method="baseline").tracked.sum()
    assert lines == [["True"] * 3, [str(tracked)], ["plans"]] and len(started) == 2
    for _ in range(600):
        if not any(map(alive, started)):
            return
        time.sleep(0.1)
    pytest.fail(f"still there: {started}")


def alive(process):
    """Return True if the process exists and is no zombie."""
    stat = Path(f"/proc/{process}/stat")
    try:
        os.kill(process, 0)
        return not stat.exists() or stat.read_text().rpartition(")")[2].split()[0] != "Z"
    except (ProcessLookupError, FileNotFoundError):
        return False


@pytest.mark.parametrize("count", [1, 2, 7, 49, 125, 512])
@pytest.mark.parametrize("workers", [2, 3, 64])
def test_every_scenario_is_in_one_part_and_no_part_is_much_larger(count, workers):
    parts = shares(count, workers)
    assert sorted(np.concatenate(parts).tolist()) == list(range(count))
    sizes = [len(part) for part in parts]
    assert min(sizes) > 0 and max(sizes) <= min(sizes) + 1 and max(sizes) <= processes.MOST_TOGETHER
    assert len(parts) >= min(count, workers)


def test_fewer_processes_than_one_are_refused():
    with pytest.raises(InputError, match="processes is 0; it must be 1 or more"):
        toy.planned(processes=0)


@pytest.mark.skipif(cache_folder.fcntl is None, reason="no locks here")
def test_who_comes_second_compiles_after_the_first(tmp_path):
    """Compilation of one executable by two threads: the second waits and loads the result; other ones do not wait."""
    before = jax.config.jax_compilation_cache_dir
    jax.config.update("jax_compilation_cache_dir", str(tmp_path))
    entered = threading.Event()

    def second():
        with cache_folder.compilation_lock(f"advance-{0:048}"):
            entered.set()

    try:
        with cache_folder.compilation_lock(f"advance-{0:048}"):
            waiting = threading.Thread(target=second)
            waiting.start()
            with cache_folder.compilation_lock(f"advance-{1:0<48}"):
                assert not entered.wait(0.2)
        waiting.join()
        assert entered.is_set()
    finally:
        jax.config.update("jax_compilation_cache_dir", before)

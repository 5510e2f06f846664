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
import made_once
import numpy as np
import own_obstacles
import pytest
import small_motions

import htcp_jax
from htcp_jax.device import compile_cache, processes
from htcp_jax.device.processes import portable, shares, that_pay
from htcp_jax.errors import InputError, Lost
from htcp_jax.model.scenario import make_scenario, stack
from htcp_jax.planning import batch
from htcp_jax.planning.batch import plan
from htcp_jax.planning.registry import METHODS, Method
from htcp_jax.runs.sweep import sweep
from htcp_jax.settings import Settings
from htcp_jax.status import Status

pytestmark = pytest.mark.skipif(jax.default_backend() != "cpu", reason="GPUs are not shared out among processes")
ROOT = Path(__file__).parents[1]
PAPER = Settings(**made_once.PAPER_CHOICES)
ROTATIONS = ((0.4, 0.1), (0.8, -0.3), (0.6, 0.0), (0.2, -0.3), (0.5, 0.2))


def scene():
    return made_once.robot(), made_once.duct()


def poses():
    """Five scenarios, the third of which is refused before planning."""
    made = [make_scenario(*scene(), made_once.START, rotation=rotation, margin_m=0.0, number=k)
            for k, rotation in enumerate(ROTATIONS)]  # fmt: skip
    scenarios = stack(made)
    scenarios.refused[2] = Status.HOME_IN_COLLISION
    return scenarios


def same(a, b):
    for name, array in a.arrays().items():
        np.testing.assert_array_equal(array, b.arrays()[name], err_msg=name)
    for one, other in zip(a.knots, b.knots, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("count", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_the_number_of_processes_has_no_influence(count):
    """All arrays and via points, bitwise the same as in one process, with one engine or with two."""
    here = plan(*scene(), poses(), "cspace-sample", PAPER, threads=2)
    same(here, plan(*scene(), poses(), "cspace-sample", PAPER, processes=count))
    same(small_motions.planned(), small_motions.roadmap(small_motions.poses(), processes=count))
    assert here.tracked.any() and len(small_motions.planned().knots.scenario)


def again(progress=None):
    """Plan in two processes, with the fewest executables to compile in each."""
    return plan(*scene(), poses(), "baseline", PAPER, progress=progress, processes=2, check_paths=False)


def test_progress_counts_what_all_processes_have_done():
    heard = []
    plans = again(heard.append)
    last = heard[-1]
    assert last.scenarios_done == last.scenarios == len(ROTATIONS)
    assert last.targets == 105 * len(ROTATIONS) and last.targets_tracked == plans.tracked.sum() > 0
    for field in ("scenarios_done", "targets_tracked"):
        counts = [getattr(now, field) for now in heard]
        assert counts == sorted(counts)


def test_what_a_worker_raises_arrives():
    with pytest.raises(InputError, match="'nonsense' is no QP solver; valid: clarabel"):
        plan(*scene(), poses(), "baseline", replace(PAPER, qp="nonsense"), processes=2)


def test_what_progress_raises_ends_the_work_and_the_next_plan_begins_anew():
    def stop(now):
        raise ArithmeticError("enough")

    with pytest.raises(ArithmeticError, match="enough"):
        again(progress=stop)
    assert again().tracked.any()


def test_a_worker_that_is_killed_is_told_of(monkeypatch):
    """A killed worker: an error at once, and the next call works."""
    workers, executor = [], processes._executor
    monkeypatch.setattr(processes, "_executor", lambda count: workers.append(executor(count)) or workers[-1])

    def kill(now):
        for worker in list(workers[0]._processes):
            with contextlib.suppress(ProcessLookupError):  # when one has ended, loky ends the others
                os.kill(worker, signal.SIGKILL)

    with pytest.raises(Lost, match="a worker process is gone"):
        again(progress=kill)
    assert again().tracked.any()


class Here(Method):
    """A planner that no other process can have."""

    name, title, description = "here", "Here", "says which process has planned"
    seen = ()

    def plan(self, problem):
        Here.seen = (*Here.seen, os.getpid())
        return problem.empty_plans()


def test_a_method_of_this_process_plans_here():
    htcp_jax.register(Here())
    try:
        plan(*scene(), poses(), "here", PAPER, processes=2)
    finally:
        METHODS.unregister("here")
    assert Here.seen == (os.getpid(),)


def test_what_cannot_be_imported_elsewhere_is_not_sent(monkeypatch):
    floor = own_obstacles.Floor(np.float64(-5.0))
    assert portable(*scene(), floor)
    monkeypatch.setattr(own_obstacles.Floor, "__module__", "__main__")
    monkeypatch.setattr(sys.modules["__main__"], "Floor", own_obstacles.Floor, raising=False)
    assert portable(floor) is None and portable(lambda: 0) is None


SCRIPT = """
import jax, numpy as np
from htcp_jax.device import processes
from htcp_jax.planning import batch
from htcp_jax.io import robot_file, workpiece_file
from htcp_jax.model import scenario

arm, duct = robot_file.gp50(), workpiece_file.load_workpiece()
start = (0.0, -2.3, 0.5, 0.0, 0.5, -2.0)
poses = scenario.stack([scenario.make_scenario(arm, duct, start, rotation=(wy, 0.1)) for wy in (0.3, 0.4, 0.5, 0.6)])
print("begins", flush=True)
heard, workers, executor = [], [], processes._executor
processes._executor = lambda count: workers.append(executor(count)) or workers[-1]

def hear(now):
    if now.targets_tracked and not heard:
        heard.append(now)
        print(*workers[0]._processes, flush=True)
        {then}

plans = batch.plan(arm, duct, poses, "baseline", processes=2, progress=hear)
print(plans.tracked.sum())
"""


def script(then):
    """Start a script without a guard from standard input, like the cells of a notebook."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])}
    piped = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    started = subprocess.Popen([sys.executable, "-"], env=environment, **piped)
    started.stdin.write(SCRIPT.format(then=then))
    started.stdin.close()
    return started


def test_a_script_needs_no_guard():
    with script("pass") as running:
        begins, workers, tracked = running.stdout.read().splitlines()
    assert running.returncode == 0 and begins == "begins" and len(workers.split()) == 2 and int(tracked) > 100


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="a process is not told that its parent is gone")
def test_workers_end_with_the_process_that_started_them():
    """End of the workers after their parent process ended, even if it was killed."""
    with script("import os; os.kill(os.getpid(), 9)") as running:
        workers = [int(word) for word in running.stdout.read().splitlines()[-1].split()]
    assert len(workers) == 2
    for _ in range(600):
        if not any(map(alive, workers)):
            return
        time.sleep(0.1)
    pytest.fail(f"still there: {workers}")


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


def test_few_scenarios_need_no_worker_and_many_do():
    assert that_pay(64, 1, 10**6) == that_pay(64, 15, 10**6) == that_pay(1, 1000, 10**6) == 1
    assert that_pay(2, 49, 5145) == 1 and that_pay(2, 49, 10290) == 2
    assert that_pay(64, 125, 13125) == 15  # at least eight scenarios each


def test_the_same_call_plans_in_the_same_number_of_processes_however_often_it_was_made(monkeypatch):
    """Count the processes of one call with too few targets for workers, made until all calls have more than enough, and
    of the same call as one of a sweep's with more than enough."""
    found = []
    monkeypatch.setattr(batch, "_spread", lambda processes, *_: found.append(processes))
    monkeypatch.setattr(batch, "_planned_here", lambda problem, *_: found.append(1) or problem.empty_plans())
    monkeypatch.setattr(batch, "default_threads", lambda *_: 2)
    many = stack([made_once.nominal()] * 16)
    for _ in range(10):
        plan(*scene(), many, "baseline", PAPER)
    assert 10 * int(many.count.sum()) > processes.START_PAYS and found == [1] * 10
    plan(*scene(), many, "baseline", PAPER, targets_in_all=processes.START_PAYS)
    assert found[10:] == [2]


def test_the_shards_of_a_sweep_are_planned_in_as_many_processes_as_pay_for_all(monkeypatch):
    asked = []
    monkeypatch.setattr(batch, "that_pay", lambda cores, scenarios, targets: asked.append(targets) or 1)
    monkeypatch.setattr(batch, "_planned_here", lambda problem, *_: problem.empty_plans())
    found = sweep({"grid": [{"margin_m": [0.0, 0.001, 0.002]}]}, "baseline,nspace-sqp", shard_scenarios=2)
    assert asked == [2 * found.manifest.targets] * 4


def test_fewer_processes_than_one_are_refused():
    with pytest.raises(InputError, match="processes is 0; it must be 1 or more"):
        plan(*scene(), poses(), "baseline", PAPER, processes=0)


@pytest.mark.skipif(compile_cache.fcntl is None, reason="no locks here")
def test_who_comes_second_compiles_after_the_first(monkeypatch, tmp_path):
    """Compilation of one executable by two threads: the second waits and loads the result; other ones do not wait."""
    before = jax.config.jax_compilation_cache_dir
    jax.config.update("jax_compilation_cache_dir", str(tmp_path))
    entered = threading.Event()

    def second():
        with compile_cache.alone("walk 0"):
            entered.set()

    try:
        with compile_cache.alone("walk 0"):
            waiting = threading.Thread(target=second)
            waiting.start()
            with compile_cache.alone("advance"):
                assert not entered.wait(0.2)
        waiting.join()
        assert entered.is_set()
    finally:
        jax.config.update("jax_compilation_cache_dir", before)

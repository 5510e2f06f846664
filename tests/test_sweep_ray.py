"""Sweeps on a real Ray: the same bytes as in one process, also if workers, nodes or the whole cluster are killed."""

import os
import signal
import socket
import subprocess
import time
import warnings
from collections.abc import Collection
from pathlib import Path

import numpy as np
import pytest
import toy
import trimesh
from sweep_process import COLD, HALF, SHARDS, finish, plan_half, rows, start, without_progress

from htcp_jax.cli import main
from htcp_jax.errors import InputError
from htcp_jax.runs import open_run
from htcp_jax.runs.provenance import planned_by
from htcp_jax.runs.ray_ import execution_of
from htcp_jax.runs.sweep import device_of, sweep
from htcp_jax.spec.config import RayConfig

ray = pytest.importorskip("ray", reason="Ray is an extra")
WORKING = "ray::_plan_shard"
pytestmark = pytest.mark.filterwarnings(r"ignore:os\.fork\(\) was called:RuntimeWarning")  # Ray starts programs so


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory) -> dict[str, bytes]:
    """Row files of a sweep in one process."""
    folder = tmp_path_factory.mktemp("undisturbed")
    toy.write_sweep(folder)
    return rows(sweep(folder / "grid.yaml", "baseline", folder / "run", shard_scenarios=1).folder)


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    toy.write_sweep(tmp_path)
    return tmp_path


@pytest.fixture
def one_worker():
    """A Ray of this process with a slot for one task."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Ray's own
        ray.init("local", num_cpus=1, include_dashboard=False, log_to_driver=False, configure_logging=False)
        yield
        ray.shutdown()


def processes() -> dict[int, tuple[int, str]]:
    """Parent and command line of every process."""
    found = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            words = (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
            found[int(folder.name)] = int((folder / "stat").read_text().rpartition(")")[2].split()[1]), words
        except OSError:
            continue  # it has just ended
    return found


def under(top: int) -> list[int]:
    """Processes below `top` that are planning a shard."""
    all_ = processes()

    def is_below(pid: int) -> bool:
        while pid in all_ and pid != top:
            pid = all_[pid][0]
        return pid == top

    return [pid for pid, (_, words) in all_.items() if words.startswith(WORKING) and is_below(pid)]


def wait_for_worker(top: int, driver: subprocess.Popen, known: Collection[int] = ()) -> int:
    """First process below `top` seen planning that is not `known`."""
    while driver.poll() is None:
        if found := [pid for pid in under(top) if pid not in known]:
            return found[0]
        time.sleep(0.02)
    raise AssertionError(driver.communicate())


def test_ray_plans_the_same_bytes_as_one_process(here, undisturbed, one_worker):
    run = sweep("grid.yaml", "baseline", "run", shard_scenarios=1, on="ray")
    assert run.complete and rows(run.folder) == undisturbed
    (by,) = run.manifest.planned_by
    assert by == planned_by()


def test_the_methods_that_last_longest_begin_first(here, one_worker):
    """Order of the methods: slowest first, whatever the order in the command, so that none remains for one worker."""
    began = []
    methods = "baseline,nspace-sample,cspace-sample"
    sweep("grid.yaml", methods, limit=1, on="ray", finished=lambda shard: began.append(shard.method))
    assert began == ["nspace-sample", "cspace-sample", "baseline"]


@pytest.mark.slow
def test_the_command_on_ray_prints_what_it_prints_without_and_nothing_else(here, undisturbed):
    """Output of the command on a new Ray of this machine: the same as without Ray, and nothing else."""
    done = finish(here, "run", "--on", "ray:local")
    assert done.returncode == 0, done.stderr
    assert without_progress(done.stderr) == [] and done.stdout.splitlines()[0] == "grid"
    assert rows(here / "run") == undisturbed


@pytest.mark.parametrize(
    ("on", "line"),
    [
        ("cluster", "on is 'cluster'; valid: here, ray, ray:<address of a cluster>"),
        ("ray:nowhere", "cannot reach Ray at nowhere: "),
        ("ray:999.0.0.1:99999", "cannot reach Ray at 999.0.0.1:99999: "),
    ],
)
def test_a_place_that_is_none_is_one_line(here, capsys, on, line):
    assert main(["sweep", "grid.yaml", "--on", on, "--out", "run"]) == 2
    assert line in (errors := capsys.readouterr().err) and errors.count("\n") == 1
    assert not (here / "run").exists()


def test_a_cluster_that_takes_connections_and_never_answers_is_one_line(here, capsys):
    with socket.create_server(("", 0)) as silent:
        port = silent.getsockname()[1]
        assert main(["sweep", "grid.yaml", "--on", f"ray:127.0.0.1:{port}", "--out", "run"]) == 2
    assert capsys.readouterr().err == f"htcp: cannot reach Ray at 127.0.0.1:{port}: timed out\n"
    assert not (here / "run").exists()


@pytest.mark.slow
def test_a_cluster_that_is_started_here_listens_to_this_machine_alone_and_requires_a_token(here):
    seen = []

    def look(_) -> None:
        seen.append((ray.nodes()[0]["NodeManagerAddress"], os.environ["RAY_AUTH_MODE"]))

    sweep("grid.yaml", "baseline", on="ray:local", finished=look)
    assert seen == [("127.0.0.1", "token")]


def test_a_device_next_to_ray_and_gpus_that_this_machine_has_not_are_one_line(here, capsys, one_worker):
    """Errors for a device next to Ray and for missing GPUs: one line, and no waiting.

    GPUs belong to the workers; a Ray of this machine would wait for one that never comes.
    """
    for words, line in (
        (
            ("--device", "gpu"),
            "device is 'gpu'; with Ray it must be cpu; to use GPUs of the workers, set ray.num_gpus",
        ),
        (("--set", "ray.num_gpus=0.5"), "ray.num_gpus is 0.5, but this machine has 0 GPUs; set a smaller number"),
    ):
        assert main(["sweep", "grid.yaml", "--on", "ray", "--out", "run", *words]) == 2
        assert capsys.readouterr().err == f"htcp: {line}\n"
        assert not (here / "run").exists()


@pytest.mark.parametrize(
    "qps, threads", [(["device"], None), (["device", "clarabel"], 8)], ids=["on the gpu", "one on the cpu"]
)
def test_a_gpu_that_solves_its_qps_needs_no_threads_for_the_cores_of_a_shard(qps, threads):
    assert execution_of(RayConfig(num_cpus=8, num_gpus=1), *qps).threads == threads
    assert execution_of(RayConfig(num_cpus=8), *qps).threads == 8


def test_with_ray_the_command_leaves_gpus_to_the_workers():
    """Device of the command with Ray: the CPU.

    It would allocate three quarters of a GPU's memory, which the worker next to it needs.
    """
    assert device_of("ray", None) == device_of("ray:local", "cpu") == "cpu"
    assert device_of("here", None) is None and device_of("here", "gpu:2") == "gpu:2"


def test_what_a_shard_asks_of_the_cluster_is_no_part_of_a_runs_identity(here):
    sweep("grid.yaml", "baseline", "run", limit=1)
    assert sweep("grid.yaml", "baseline", "run", overrides=["ray.num_gpus=0.5"], limit=1).complete
    with pytest.raises(InputError, match=r"ray\.num_gpus is -1"):
        sweep("grid.yaml", "baseline", overrides=["ray.num_gpus=-1"])


@pytest.mark.slow
def test_shards_of_killed_workers_are_planned_by_others(here, undisturbed):
    with start(here, "run", "--on", "ray:local", **COLD) as driver:
        killed = set()
        while len(killed) < 2:
            killed.add(worker := wait_for_worker(driver.pid, driver, killed))
            os.kill(worker, signal.SIGKILL)
        _, errors = driver.communicate()
    assert driver.returncode == 0, errors
    assert rows(here / "run") == undisturbed


@pytest.mark.slow
def test_a_driver_killed_with_its_ray_goes_on_to_the_same_bytes(here, undisturbed):
    plan_half(here, "run")
    with start(here, "run", "--on", "ray:local", **COLD) as driver:
        wait_for_worker(driver.pid, driver)
        driver.kill()
    assert len(open_run("run").manifest.shards) == HALF
    assert finish(here, "run", "--on", "ray:local").returncode == 0
    assert rows(here / "run") == undisturbed


@pytest.mark.slow
def test_a_signal_drops_the_shards_at_hand_and_the_same_command_goes_on(here, undisturbed):
    plan_half(here, "run")
    with start(here, "run", "--on", "ray:local", **COLD) as driver:
        wait_for_worker(driver.pid, driver)
        driver.send_signal(signal.SIGTERM)
        _, errors = driver.communicate()
    assert driver.returncode == 143 and f"htcp: stopped; {HALF} of {SHARDS} shards" in errors
    assert sweep("grid.yaml", "baseline", "run", shard_scenarios=1).complete and rows(here / "run") == undisturbed


@pytest.fixture
def cluster(monkeypatch):
    """Two real nodes on this machine: the head, which plans nothing, and another.

    Their workers are COLD, so that they are at work when the node is killed.
    """
    from ray.cluster_utils import Cluster

    for name, value in COLD.items():
        monkeypatch.setenv(name, value)
    nodes = Cluster(initialize_head=True, head_node_args={"num_cpus": 0, "include_dashboard": False})
    nodes.add_node(num_cpus=1)
    nodes.wait_for_nodes()
    yield nodes
    nodes.shutdown()


def raylet(node) -> int:
    """Process id of a node."""
    return node.all_processes["raylet"][0].process.pid


@pytest.mark.slow
def test_shards_of_a_killed_node_are_planned_by_another(here, undisturbed, cluster):
    (node,) = [each for each in cluster.list_all_nodes() if each is not cluster.head_node]
    plan_half(here, "run")
    with start(here, "run", "--on", f"ray:{cluster.address}") as driver:
        wait_for_worker(raylet(node), driver)
        os.kill(raylet(node), signal.SIGKILL)
        cluster.add_node(num_cpus=1)
        _, errors = driver.communicate()
    assert driver.returncode == 0, errors
    assert rows(here / "run") == undisturbed


@pytest.mark.slow
def test_when_the_whole_cluster_is_lost_what_is_finished_is_kept(here, undisturbed, cluster):
    (node,) = [each for each in cluster.list_all_nodes() if each is not cluster.head_node]
    plan_half(here, "run")
    with start(here, "run", "--on", f"ray:{cluster.address}") as driver:
        wait_for_worker(raylet(node), driver)
        for each in (node, cluster.head_node):
            os.kill(raylet(each), signal.SIGKILL)
        _, errors = driver.communicate()
    assert driver.returncode == 1, errors
    (line,) = [line for line in errors.splitlines() if line.startswith("htcp: ")]  # among Ray's own output
    assert line.startswith("htcp: Ray lost its workers") and line.endswith("run the same command to resume")
    assert f"{HALF} of {SHARDS} plans are finished" in line
    assert finish(here, "run").returncode == 0 and rows(here / "run") == undisturbed


@pytest.mark.slow
def test_a_sweep_of_cells_on_ray_is_the_same_bytes_and_none_is_continued_with_another_mesh(here, one_worker):
    """Sweep of cells on Ray: the same bytes, and no resumption with another mesh.

    A fixture of every kind of obstacle, shifted by the grid.
    """
    trimesh.creation.box([0.1, 0.1, 0.1]).export("vice.stl")
    trimesh.creation.annulus(0.35, 0.4, 0.2).export("ring.stl")
    Path("cell.xml").write_text(
        '<mujoco><asset><mesh name="vice" file="vice.stl"/><mesh name="ring" file="ring.stl"/></asset><worldbody>'
        '<geom type="plane" size="3 3 1" pos="0 0 -0.6"/><geom type="cylinder" size="0.1 0.1" pos="0 2 1"/>'
        '<geom type="mesh" mesh="vice" pos="2 2 1"/><geom type="mesh" mesh="ring" pos="-2 0 1"/></worldbody></mujoco>'
    )
    np.savetxt("scan.xyz", np.random.default_rng(0).uniform(-0.1, 0.1, (30, 3)))
    cell = "cell: {self_collision: true, model: cell.xml, clouds: [{cloud: scan.xyz, base_m: [0, -2, 1]}]}\n"
    Path("job.yaml").write_text(Path("job.yaml").read_text() + cell)
    Path("grid.yaml").write_text("config: job.yaml\ngrid:\n  - cell.shift_m.y: [0, 0.1]\n")
    runs = [
        sweep("grid.yaml", "baseline", name, shard_scenarios=1, on=on) for name, on in (("a", "ray"), ("b", "here"))
    ]
    assert runs[0].complete and rows(runs[0].folder) == rows(runs[1].folder)
    trimesh.creation.box([0.1, 0.1, 0.11]).export("vice.stl")
    with pytest.raises(InputError, match=r"a contains another sweep: parts\.vice\.stl was SHA-256 "):
        sweep("grid.yaml", "baseline", "a", shard_scenarios=1)

"""Planning of a sweep's shards on a Ray cluster of one or more machines.

Every shard is a Ray task. A worker needs only this package: the driver sends it the arm, the workpiece and the
scenarios, receives the plans, and writes them. A task whose worker or node dies is retried on another worker. Results
do not depend on the worker. On equal CPUs they equal the results of `local`. On GPUs they are equal up to rounding, as
the driver prepares the inputs on a CPU.
"""

import contextlib
import logging
import os
import socket
import warnings
from collections.abc import Callable, Iterator, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from htcp_jax.caching import cache_folder
from htcp_jax.errors import InputError, Lost, install_command
from htcp_jax.jobs import Batch, PlannerInputs
from htcp_jax.model import Scenario
from htcp_jax.motion import Execution, Plans
from htcp_jax.planning import registry
from htcp_jax.runs.local import PlannedShard, plan_cells, scenarios_of
from htcp_jax.runs.provenance import planned_by
from htcp_jax.runs.shards import Shard, ShardSizes
from htcp_jax.spec import PlanConfig
from htcp_jax.spec import config as configs

ANSWER_S = 5.0  # timeout for a connection to a cluster, and for its first response [s]
HTTP2 = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + bytes((0, 0, 0, 4, 0, 0, 0, 0, 0))  # connection preface of a gRPC client
TRIES = 5  # maximum number of attempts, one second each, to connect to a cluster
POLL_S = 0.5  # time between two checks for a signal [s]
GPU_SHARE = 0.75  # share of a GPU's memory that JAX allocates by default


@contextlib.contextmanager
def on_ray(batch: Batch, config: PlanConfig, sizes: ShardSizes, address: str) -> Iterator[Callable]:
    """Connect to a Ray cluster and yield a function plan(missing, report), which yields the plans of each shard.

    Args:
        batch: The scenarios of the sweep.
        config: Configuration with the resources per shard, in its section `ray`.
        sizes: Sizes of the shards.
        address: Address of the cluster; "": the cluster that Ray finds, or a new one on this machine.

    Raises:
        InputError: If Ray is not installed or cannot be reached, or if this machine has too few GPUs for a shard.
        Lost: Raised by plan, if the workers of a shard died more often than `ray.retries` allows or the cluster died.
    """
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    try:
        import ray  # here, as it is an optional dependency
    except ImportError:
        raise InputError(f"Ray is not installed; install it with: {install_command('ray')}") from None
    logging.getLogger("ray").setLevel(logging.ERROR)
    ours = not ray.is_initialized()
    try:
        if ours:
            # Ray starts its processes by fork, which JAX warns of.
            warnings.filterwarnings("ignore", r"os\.fork\(\) was called", RuntimeWarning)
            with _constants(ray, **({"NUM_REDIS_GET_RETRIES": TRIES} if _is_there(address) else _own_cluster())):
                ray.init(address or None, include_dashboard=False, log_to_driver=False, configure_logging=False)
    except Exception as error:  # Ray raises exceptions of many types, including Exception
        raise InputError(f"cannot reach Ray at {address or 'this machine'}: {' '.join(str(error).split())}") from None
    try:
        _refuse_missing_gpus(ray, config.ray)
        yield lambda missing, report: _plan(ray, batch, config, sizes, missing, report)
    except Lost:
        ours = False  # no shutdown: after a node has died, it may end this process before the message is printed
        raise
    finally:
        if ours:
            with contextlib.suppress(Exception):
                ray.shutdown()


def _is_there(address: str) -> bool:
    """Return True if a cluster responds at the address; False if there is none to connect to, so it must be started.

    Raises:
        OSError: If no cluster responds at the address. Ray by itself would retry for a minute and print messages.
    """
    from ray._private.services import canonicalize_bootstrap_address

    if address.startswith("ray://"):  # address for Ray's client
        place = address.removeprefix("ray://")
    elif (place := canonicalize_bootstrap_address(address or None)) is None:
        return False
    host, _, port = place.rpartition(":")
    with socket.create_connection((host.strip("[]"), int(port)), ANSWER_S) as connection:
        connection.sendall(HTTP2)
        if not connection.recv(1):
            raise ConnectionError("closed the connection")
    return True


def _own_cluster() -> dict[str, bool]:
    """Prepare a new local cluster: enable authentication by a token, and return constants to set in Ray.

    With these constants the cluster listens only on 127.0.0.1. Otherwise Ray would replace this address by another one,
    except on systems such as Windows, where its clusters are confined to one machine.
    """
    from ray._private.authentication.authentication_token_setup import enable_token_auth_by_default

    enable_token_auth_by_default()  # unless the variable RAY_AUTH_MODE is set
    return {"ENABLE_RAY_CLUSTER": False}


@contextlib.contextmanager
def _constants(ray, **values: int | bool) -> Iterator[None]:
    """Set constants of the module ray_constants of Ray during a block."""
    known = vars(ray._private.ray_constants)
    before = {name: known[name] for name in values}
    known.update(values)
    try:
        yield
    finally:
        known.update(before)


def _on_host(cell: PlannerInputs) -> PlannerInputs:
    arrays = jax.tree.map(np.asarray, (cell.robot, cell.obstacles))
    return cell._replace(robot=arrays[0], obstacles=arrays[1])


def _plan(
    ray, batch: Batch, config: PlanConfig, sizes: ShardSizes, missing: Sequence[Shard], report: Callable
) -> Iterator[PlannedShard]:
    """Plan the missing scenarios on the cluster, and yield the plans of each shard when it is finished.

    More tasks are queued than the cluster can run, so that workers are never idle and the cluster may scale up. The
    slowest methods (the last ones in `registry.names`) start first, so that all workers finish at about the same time.
    """
    task = ray.remote(_plan_shard).options(
        num_cpus=config.ray.num_cpus,
        num_gpus=config.ray.num_gpus,
        max_retries=config.ray.retries,
        runtime_env={"env_vars": _environment(config.ray)},
    )
    names = registry.names()
    left, running = sizes.cut(sorted(missing, key=lambda shard: -names.index(shard.method))), {}
    try:
        cells = [ray.put(_on_host(cell)) for cell in batch.cells]
        while True:
            room = 2 * int(ray.cluster_resources().get("CPU", 1)) + 8 - len(running)
            for _, shard in zip(range(room), left):  # noqa: B905 - stops at `room`
                cell, scenarios = scenarios_of(batch, shard.rows)
                wanted, cell = np.unique(cell, return_inverse=True)
                own = [cells[number] for number in wanted]
                running[task.remote(shard.method, scenarios, config.ray, cell, *own)] = shard
            if not running:
                return
            if not _own_node_answers(ray):
                running.clear()
                raise Lost("Ray lost its workers (the node of this process has stopped)")
            done, _ = ray.wait(list(running), timeout=POLL_S)
            report(next(iter(running.values())).method)
            if not any(node["Alive"] for node in ray.nodes()):  # Ray by itself would wait without end
                running.clear()
                raise Lost("Ray lost its workers (no node is left)")
            for ref in done:
                shard, (plans, by) = running.pop(ref), ray.get(ref)
                sizes.note(shard, plans.run_s)
                yield PlannedShard(shard, plans, by, max(1, int(config.ray.num_cpus)))
    except ray.exceptions.RayTaskError as error:
        raise error.cause from None  # the exception of the planner on the worker
    except (ray.exceptions.RayError, OSError) as error:  # OSError: Ray writes to a dead node
        if isinstance(error, ray.exceptions.LocalRayletDiedError | OSError):
            running.clear()  # no tasks are cancelled: no node is left, and Ray might end this process
        raise Lost(f"Ray lost its workers ({type(error).__name__})") from None
    finally:
        with contextlib.suppress(Exception):
            for ref in running:
                ray.cancel(ref, force=True)


def _refuse_missing_gpus(ray, share: configs.RayConfig) -> None:
    """Check that a cluster started by this process has the GPUs that a shard requires.

    Such a cluster has only this machine. An existing cluster is not checked, as it may scale up.

    Raises:
        InputError: If the machine has too few GPUs.
    """
    node = ray._private.worker.global_worker.node
    if node is not None and node.is_head() and (has := ray.cluster_resources().get("GPU", 0)) < share.num_gpus:
        raise InputError(f"ray.num_gpus is {share.num_gpus:g}, but this machine has {has:g} GPUs; set a smaller number")


def _own_node_answers(ray) -> bool:
    """Return True if the Ray node of this process is alive.

    Ray detects the death of a node only after some seconds. An access to the node's memory then ends this
    process without an exception.
    """
    node = getattr(ray._private.worker.global_worker, "node", None)
    if node is None:  # connected by Ray's client: the node belongs to another process
        return True
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as knock:
        try:
            knock.connect(node.raylet_socket_name)
        except OSError:
            return False
    return True


def _plan_shard(
    method: str, scenarios: Scenario, share: configs.RayConfig, cell: Int[np.ndarray, "S"], *cells: PlannerInputs
) -> tuple[Plans, dict]:
    """Plan one shard on a worker, and return the plans with their provenance."""
    cache_folder.enable()
    cells = [each._replace(robot=jax.tree.map(jnp.asarray, each.robot)) for each in cells]
    execution = execution_of(share, *(each.settings.qp for each in cells))
    return plan_cells(cells, cell, scenarios, method, execution), planned_by()


def execution_of(share: configs.RayConfig, *qps: str) -> Execution:
    """Return how a worker plans a shard: with one thread per core of its share, or the default number on a GPU.

    With eight threads on one H200 the six methods of the paper take 2.4 times as long.

    Args:
        share: The resources of the shard.
        qps: Solvers of the step QPs, `settings.qp`. If a solver runs on the CPU, a GPU needs the threads, too.
    """
    on_gpu = share.num_gpus and set(qps) == {"device"}
    return Execution(threads=None if on_gpu else max(1, int(share.num_cpus)))


def _environment(share: configs.RayConfig) -> dict[str, str]:
    """Return the environment variables of the workers.

    A task that requests no GPU uses the CPU. Tasks that share a GPU get a part of its memory each.
    """
    if not share.num_gpus:
        return {"JAX_PLATFORMS": "cpu"}
    return {"XLA_PYTHON_CLIENT_MEM_FRACTION": f"{GPU_SHARE * min(1.0, share.num_gpus):.3f}"}

"""Planning the shards of a sweep on Ray: a larger machine, or many.

Every shard is a task. A worker needs this package and nothing else: the arm, the workpiece and the scenarios travel to
it, plans travel back, and the process that was called writes them. A task whose worker or node dies is given to
another one. Results do not depend on who planned a shard: they are those of `local` on equal CPUs; on GPUs they are to
rounding, as the process that was called makes on a CPU what it hands out.
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

from htcp_jax.device import compile_cache
from htcp_jax.errors import InputError, Lost
from htcp_jax.jobs.config import PlanConfig, RayConfig
from htcp_jax.jobs.grid import Batch, Cell
from htcp_jax.model.scenario import Scenario
from htcp_jax.motion.plans import Plans
from htcp_jax.planning import registry
from htcp_jax.runs.local import Planned, Shard, plan_cells, scenarios_of
from htcp_jax.runs.provenance import planned_by

ANSWER_S = 5.0  # for a connection to a cluster, and for its first answer
HTTP2 = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + bytes((0, 0, 0, 4, 0, 0, 0, 0, 0))  # how a gRPC client begins
TRIES = 5  # a second each, to connect to a cluster that answers, but not as Ray
LOOK_S = 0.5  # how often a waiting sweep looks for a signal
GPU_SHARE = 0.75  # of a GPU's memory that JAX takes for itself unless told


@contextlib.contextmanager
def on_ray(batch: Batch, config: PlanConfig, address: str) -> Iterator[Callable]:
    """Connects to the cluster at `address`, without one to the cluster that Ray knows of or to a new one of this
    machine, and hands out plan(shards, report), see `local.plan_here`.

    Raises InputError where Ray is not installed, not there, or this machine has not the GPUs of a shard; plan raises
    Lost when a shard's workers died more often than `config.ray.retries` allows, or the cluster did.
    """
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    try:
        import ray  # here, because it is an extra
    except ImportError:
        raise InputError("Ray is not installed; get it with: pip install 'htcp_jax[ray]'") from None
    logging.getLogger("ray").setLevel(logging.ERROR)
    ours = not ray.is_initialized()
    try:
        if ours:
            warnings.filterwarnings("ignore", r"os\.fork\(\) was called", RuntimeWarning)  # Ray starts programs so
            with _constants(ray, **({"NUM_REDIS_GET_RETRIES": TRIES} if _is_there(address) else _own_cluster())):
                ray.init(address or None, include_dashboard=False, log_to_driver=False, configure_logging=False)
    except Exception as error:  # of many kinds, plain Exception among them
        raise InputError(f"cannot reach Ray at {address or 'this machine'}: {' '.join(str(error).split())}") from None
    try:
        _refuse_missing_gpus(ray, config.ray)
        yield lambda shards, report: _plan(ray, batch, config, shards, report)
    except Lost:
        ours = False  # Ray may end this process over a node that is gone, and what is to be told is not told yet
        raise
    finally:
        if ours:
            with contextlib.suppress(Exception):
                ray.shutdown()


def _is_there(address: str) -> bool:
    """True for a cluster that answers, False where a new one is to be started. Raises OSError for one that does not
    answer: Ray itself would go on trying for a minute, and print about it."""
    from ray._private.services import canonicalize_bootstrap_address

    if address.startswith("ray://"):  # Ray's client
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
    """Constants with which a cluster that is started listens to 127.0.0.1 alone; and it requires the user's token. Ray
    takes another address for 127.0.0.1, unless its clusters are confined to one machine, as on Windows."""
    from ray._private.authentication.authentication_token_setup import enable_token_auth_by_default

    enable_token_auth_by_default()  # RAY_AUTH_MODE, if it is set, decides
    return {"ENABLE_RAY_CLUSTER": False}


@contextlib.contextmanager
def _constants(ray, **values: int | bool) -> Iterator[None]:
    """A block in which constants of Ray have other values."""
    known = vars(ray._private.ray_constants)
    before = {name: known[name] for name in values}
    known.update(values)
    try:
        yield
    finally:
        known.update(before)


def _on_host(cell: Cell) -> Cell:
    arrays = jax.tree.map(np.asarray, (cell.robot, cell.obstacles))
    return cell._replace(robot=arrays[0], obstacles=arrays[1])


def _plan(ray, batch: Batch, config: PlanConfig, shards: Sequence[Shard], report: Callable) -> Iterator[Planned]:
    """Keeps more tasks waiting than the cluster has room for: it never idles, and one that can grow does. The methods
    that last longest, which `registry.names` has last, begin first: none is left for one worker at the end."""
    task = ray.remote(_plan_shard).options(
        num_cpus=config.ray.num_cpus,
        num_gpus=config.ray.num_gpus,
        max_retries=config.ray.retries,
        runtime_env={"env_vars": _environment(config.ray)},
    )
    names = registry.names()
    left, running = iter(sorted(shards, key=lambda shard: -names.index(shard.method))), {}
    try:
        cells = [ray.put(_on_host(cell)) for cell in batch.cells]
        while True:
            room = 2 * int(ray.cluster_resources().get("CPU", 1)) + 8 - len(running)
            for _, shard in zip(range(room), left):  # noqa: B905 - as many as there is room for
                cell, scenarios = scenarios_of(batch, shard.span)
                wanted, cell = np.unique(cell, return_inverse=True)
                own = [cells[number] for number in wanted]
                running[task.remote(shard.method, scenarios, config.ray, cell, *own)] = shard
            if not running:
                return
            if not _own_node_answers(ray):
                running.clear()
                raise Lost("Ray lost its workers (this process's own node is gone)")
            done, _ = ray.wait(list(running), timeout=LOOK_S)
            report(next(iter(running.values())).method)
            if not any(node["Alive"] for node in ray.nodes()):  # Ray itself would wait for ever
                running.clear()
                raise Lost("Ray lost its workers (no node is left)")
            for ref in done:
                yield Planned(running.pop(ref), *ray.get(ref))
    except ray.exceptions.RayTaskError as error:
        raise error.cause from None  # what the planner itself raised
    except (ray.exceptions.RayError, OSError) as error:  # OSError: Ray writes to a node that is no more
        if isinstance(error, ray.exceptions.LocalRayletDiedError | OSError):
            running.clear()  # there is nobody to cancel it, and Ray may end this process over trying
        raise Lost(f"Ray lost its workers ({type(error).__name__})") from None
    finally:
        with contextlib.suppress(Exception):
            for ref in running:
                ray.cancel(ref, force=True)


def _refuse_missing_gpus(ray, share: RayConfig) -> None:
    """Raise InputError for GPUs that never come: a Ray that this process has begun is of this machine alone. A cluster
    may grow, and is waited for."""
    node = ray._private.worker.global_worker.node
    if node is not None and node.is_head() and (has := ray.cluster_resources().get("GPU", 0)) < share.num_gpus:
        raise InputError(f"ray.num_gpus is {share.num_gpus:g}; this machine has {has:g} GPUs")


def _own_node_answers(ray) -> bool:
    """Whether the node that this process is connected to is still there. Some seconds after it died Ray notices, and
    ends the process from within, without an exception, when it next needs the node's memory."""
    node = getattr(ray._private.worker.global_worker, "node", None)
    if node is None:  # connected by Ray's client, to a process elsewhere
        return True
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as knock:
        try:
            knock.connect(node.raylet_socket_name)
        except OSError:
            return False
    return True


def _plan_shard(
    method: str, scenarios: Scenario, share: RayConfig, cell: Int[np.ndarray, "S"], *cells: Cell
) -> tuple[Plans, dict]:
    """What a worker does: the plans of one shard, and what planned it."""
    compile_cache.enable()
    cells = [each._replace(robot=jax.tree.map(jnp.asarray, each.robot)) for each in cells]
    return plan_cells(cells, cell, scenarios, method, max(1, int(share.num_cpus))), planned_by()


def _environment(share: RayConfig) -> dict[str, str]:
    """Of the workers: no GPU for tasks that ask for none, and its part of the memory for one that shares it."""
    if not share.num_gpus:
        return {"JAX_PLATFORMS": "cpu"}
    return {"XLA_PYTHON_CLIENT_MEM_FRACTION": f"{GPU_SHARE * min(1.0, share.num_gpus):.3f}"}

"""Which devices a plan runs on: `cpu`, `gpu` (all of this host) or `gpu:2` (the first two of them)."""

import os

import jax

from htcp_jax.errors import InputError


def choose(name: str | None = None) -> list[jax.Device]:
    """The devices of that name; None is what JAX prefers: every GPU when there is one, else the CPU.

    A process computes on one kind of device. `cpu` can be chosen beside a GPU as long as nothing has been computed yet.
    Raises InputError for a name that is no device here.
    """
    if name == "cpu":
        jax.config.update("jax_platforms", "cpu")  # without effect once a device is in use
    here = jax.local_devices()
    kind = "cpu" if here[0].platform == "cpu" else "gpu"
    valid = [kind, *(f"{kind}:{count}" for count in range(1, len(here) + 1) if kind == "gpu")]
    if name is not None and name not in valid:
        raise InputError(f"device is {name!r}; valid here: {', '.join(valid)}")
    if kind == "cpu":
        return here[:1]
    _, _, count = (name or kind).partition(":")
    return here[: int(count or len(here))]


def default_threads(devices: list[jax.Device], qp: str) -> int:
    """Engines that share the scenarios. On a CPU one a core. On GPUs two each, so that one keeps its books while the
    other computes; more where the host solves the step QPs."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if devices[0].platform == "cpu":
        return cores
    return 2 * len(devices) if qp == "device" else max(cores, 2 * len(devices))

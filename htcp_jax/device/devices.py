"""Devices that plans run on: `cpu`, `gpu` (all of this host) or `gpu:2` (the first two of them).

A process computes on one kind of device, by default the one that JAX prefers: all GPUs if there are any, else the CPU.
"""

import os

import jax

from htcp_jax.errors import InputError


def choose(name: str | None = None) -> list[jax.Device]:
    """Return the devices with that name; None: those that JAX prefers.

    `cpu` can be chosen on a host with GPUs before anything is computed.

    Raises:
        InputError: For a name that is no device here.
    """
    if name == "cpu":
        jax.config.update("jax_platforms", "cpu")
    here = jax.local_devices()
    kind = "cpu" if here[0].platform == "cpu" else "gpu"
    if name is None or name == kind:
        return here[:1] if kind == "cpu" else here
    counts = {f"gpu:{count}": count for count in range(1, len(here) + 1)} if kind == "gpu" else {}
    if name not in counts:
        raise InputError(f"device is {name!r}; valid here: {', '.join([kind, *counts])}")
    return here[: counts[name]]


def default_threads(devices: list[jax.Device], qp: str) -> int:
    """Return the number of engines that share the scenarios.

    On a CPU one per core. On GPUs one each, for the largest batches; more if the host solves the step QPs.
    """
    if devices[0].platform == "cpu":
        return cores()
    return len(devices) if qp == "device" else max(cores(), 2 * len(devices))


def cores() -> int:
    """Return the number of CPU cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1

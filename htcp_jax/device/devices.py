"""Devices that plans run on: `cpu`, `gpu` (all GPUs of this host) or `gpu:2` (its first two GPUs).

A plan uses one kind of device, by default the one that JAX prefers: all GPUs if there are any, else the CPU. JAX's
configuration is not changed.
"""

import os
from contextlib import AbstractContextManager, nullcontext

import jax

from htcp_jax.backend import default_device
from htcp_jax.errors import InputError


def choose(name: str | None = None) -> list[jax.Device]:
    """Return the devices with the given name; None: the devices that JAX prefers.

    Raises:
        InputError: If this host has no such device.
    """
    here = jax.local_devices()
    gpus = [] if here[0].platform == "cpu" else here
    if name is None:
        return gpus or here[:1]
    known = _cpu() | ({"gpu": gpus} if gpus else {})
    known |= {f"gpu:{count}": gpus[:count] for count in range(1, len(gpus) + 1)}
    if name not in known:
        raise InputError(f"device is {name!r}; valid on this machine: {', '.join(known)}")
    return known[name]


def _cpu() -> dict[str, list[jax.Device]]:
    try:
        return {"cpu": jax.local_devices(backend="cpu")[:1]}
    except RuntimeError:  # JAX_PLATFORMS excludes the CPU
        return {}


def on(device: jax.Device) -> AbstractContextManager:
    """Return a context in which this thread creates arrays and runs functions on the given device."""
    return nullcontext() if device == default_device() else jax.default_device(device)


def default_threads(devices: list[jax.Device], qp: str) -> int:
    """Return the number of engines that share the scenarios.

    On a CPU the number is one per core. On GPUs it is one per GPU, for the largest batches, or more if the host solves
    the step QPs.
    """
    if devices[0].platform == "cpu":
        return cores()
    return len(devices) if qp == "device" else max(cores(), 2 * len(devices))


def cores() -> int:
    """Return the number of CPU cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1

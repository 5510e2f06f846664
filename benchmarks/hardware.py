"""What a figure was measured on."""

import os
import platform
from pathlib import Path

import jax

from htcp_jax.planner.devices import choose, default_threads


def line() -> str:
    """Processor, cores that this process may use, accelerators, versions."""
    info = Path("/proc/cpuinfo")
    names = [row.split(":")[1].strip() for row in info.read_text().splitlines() if row.startswith("model name")] or [""]
    devices = [device.device_kind for device in choose() if device.platform != "cpu"]
    cores = default_threads(jax.devices("cpu"), "clarabel")
    gpus = f", {len(devices)} x {devices[0]}" if devices else ""
    versions = f"Python {platform.python_version()}, jax {jax.__version__}"
    return f"{cores} of {os.cpu_count()} cores, {names[0]}{gpus}; {versions}"

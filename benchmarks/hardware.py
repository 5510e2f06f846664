"""Description of the machine on which a figure was measured."""

import json
import os
import platform
import shutil
import subprocess
from importlib.metadata import PackageNotFoundError
from importlib.metadata import version as version_of
from pathlib import Path

import jax

from htcp_jax.device.devices import choose, default_threads

PACKAGES = "jax", "jaxlib", "numpy", "clarabel", "mujoco"


def machine() -> dict[str, str | int]:
    """Return the processor, the cores that this process may use, and the accelerators."""
    info = Path("/proc/cpuinfo")
    names = [row.split(":")[1].strip() for row in info.read_text().splitlines() if row.startswith("model name")] or [""]
    devices = [device.device_kind for device in choose() if device.platform != "cpu"]
    cores = default_threads(jax.devices("cpu"), "clarabel")
    gpus = f", {len(devices)} x {devices[0]}" if devices else ""
    what = f"{cores} of {os.cpu_count()} cores, {names[0]}{gpus}"
    return {"machine": what, "gpus": len(devices), "kind": devices[0] if devices else "cpu"}


def line() -> str:
    """Return one line on processor, cores that this process may use, accelerators and versions."""
    return f"{machine()['machine']}; Python {platform.python_version()}, jax {jax.__version__}"


def version(package: str) -> str:
    """Return a package's name and version, or a note that it is not installed."""
    try:
        return f"{package} {version_of(package)}"
    except PackageNotFoundError:
        return f"no {package}"


def driver() -> str:
    """Return the version of the NVIDIA driver, or a note that there is none."""
    if shutil.which("nvidia-smi") is None:
        return "no NVIDIA driver"
    query = ["nvidia-smi", "--query-gpu=driver_version", "--format=csv,noheader"]
    printed = subprocess.run(query, capture_output=True, text=True).stdout.split()
    return f"NVIDIA driver {printed[0] if printed else 'unknown'}"


if __name__ == "__main__":  # for a parent process that must not initialise the accelerators
    versions = f"Python {platform.python_version()}, {', '.join(map(version, PACKAGES))}, {driver()}"
    print(json.dumps({**machine(), "versions": versions}))

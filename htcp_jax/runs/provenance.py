"""Provenance of results: versions, device, float width, commit."""

import functools
import importlib.metadata
import os
import platform
import subprocess
from pathlib import Path

import jax
import numpy as np

import htcp_jax
from htcp_jax.backend import default_device


def provenance() -> dict:
    """Return the versions, default device and float width of this process."""
    packages = ("htcp_jax", "jax", "jaxlib", "numpy", "mujoco", "clarabel", "qpsolvers")
    device = default_device()
    kind = _processor() if device.platform == "cpu" else device.device_kind
    return {
        "versions": {name: _version(name) for name in packages},
        "device": f"{device.platform}: {kind}",
        "dtype": str(np.dtype(jax.numpy.zeros(0).dtype)),
    }


@functools.cache
def _processor() -> str:
    """Return the processor's model, for which a compiler optimises, as far as the system reports it."""
    try:
        lines = (line.partition(":") for line in Path("/proc/cpuinfo").read_text().splitlines())
        found = {name.strip(): value.strip() for name, _, value in lines}
        return f"{found['model name']}, family {found['cpu family']}, model {found['model']}"
    except (OSError, UnicodeDecodeError, KeyError):  # another system or another architecture
        return platform.processor() or platform.machine()


def _version(package: str) -> str | None:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None  # run from a source tree


def planned_by() -> dict:
    """Return the versions, device, float width and commit of this process."""
    return provenance() | {"commit": commit()}


@functools.cache  # of the running code, even if another commit is checked out later
def commit() -> str | None:
    """Return the commit of this package's source, see `commit_of`."""
    return commit_of(Path(htcp_jax.__file__).parent)


def commit_of(package: Path) -> str | None:
    """Return the commit of a package's folder, with "+changes" if it was edited since; None without git."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("GIT_")}

    def git(*words: str) -> str:
        command = ["git", "-C", str(package), *words]
        return subprocess.run(command, env=environment, capture_output=True, text=True, check=True, timeout=20).stdout

    try:
        git("ls-files", "--error-unmatch", "__init__.py")
        return git("rev-parse", "HEAD").strip() + ("+changes" if git("status", "--porcelain", "--", ".") else "")
    except (OSError, subprocess.SubprocessError):
        return None

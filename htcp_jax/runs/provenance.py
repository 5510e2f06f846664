"""Provenance of results: versions, device, float type, and commit of the code."""

import functools
import hashlib
import importlib.metadata
import json
import os
import platform
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import jax

import htcp_jax
from htcp_jax.backend import default_device
from htcp_jax.spec import TASK_ROWS, PlanConfig, Registry, obstacle_kind
from htcp_jax.system import files as io_files


def provenance() -> dict:
    """Return the packages' versions, the default device and the float type of this process."""
    packages = ("htcp_jax", "jax", "jaxlib", "numpy", "mujoco", "clarabel", "qpsolvers")
    device = default_device()
    kind = _processor() if device.platform == "cpu" else device.device_kind
    return {
        "versions": {name: _version(name) for name in packages},
        "device": f"{device.platform}: {kind}",
        "dtype": str(jax.dtypes.canonicalize_dtype(float)),
    }


@functools.cache
def _processor() -> str:
    """Return the model of the processor, as far as the system reports it. Compiled code depends on the model."""
    try:
        lines = (line.partition(":") for line in Path("/proc/cpuinfo").read_text().splitlines())
        found = {name.strip(): value.strip() for name, _, value in lines}
        return f"{found['model name']}, family {found['cpu family']}, model {found['model']}"
    except (OSError, UnicodeDecodeError, KeyError):  # not Linux, or another architecture
        return platform.processor() or platform.machine()


def _version(package: str) -> str | None:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None  # the package is not installed but run from its source


def planned_by() -> dict:
    """Return the versions, device, float type, commit and XLA's flags of this process, as recorded with its results."""
    return provenance() | {"commit": commit(), "xla_flags": os.environ.get("XLA_FLAGS", "")}


@functools.cache  # the running code does not change if another commit is checked out later
def commit() -> str | None:
    """Return the commit of the source of this package, see `commit_of`, or the one from which pip installed it."""
    return commit_of(Path(htcp_jax.__file__).parent) or installed_commit("htcp_jax", Path(htcp_jax.__file__))


def installed_commit(name: str, file: Path) -> str | None:
    """Return the commit that pip recorded when it installed a distribution from a git repository (PEP 610).

    Args:
        name: Name of the distribution and of its package.
        file: The package's `__init__.py` that is in use. If it is not the installed one, the result is None.
    """
    try:
        installed = importlib.metadata.distribution(name)
    except importlib.metadata.PackageNotFoundError:
        return None
    if Path(str(installed.locate_file(f"{name}/__init__.py"))).resolve() != file.resolve():
        return None
    return json.loads(installed.read_text("direct_url.json") or "{}").get("vcs_info", {}).get("commit_id")


def commit_of(package: Path) -> str | None:
    """Return the git commit of a package's folder, with "+changes" if files differ from it; None if not in git."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("GIT_")}

    def git(*words: str) -> str:
        command = ["git", "-C", str(package), *words]
        return subprocess.run(command, env=environment, capture_output=True, text=True, check=True, timeout=20).stdout

    try:
        git("ls-files", "--error-unmatch", "__init__.py")
        return git("rev-parse", "HEAD").strip() + ("+changes" if git("status", "--porcelain", "--", ".") else "")
    except (OSError, subprocess.SubprocessError):
        return None


def code_of(added: Registry, names: Iterable[str]) -> dict[str, str]:
    """Return the SHA-256 of the source files of extensions that are not built in, by "noun name".

    The hash covers all files of the extension's top-level package. Extensions without a source file, such as those
    defined in a notebook, are excluded.

    Args:
        added: The registry of the extensions.
        names: Names of extensions; built-in ones are ignored.
    """
    found = {}
    for name in filter(added.is_added, names):
        if files := _source_files(added.find(name)):
            data = b"".join(map(io_files.read_bytes, files))
            found[f"{added.noun} {name}"] = hashlib.sha256(data).hexdigest()
    return found


def code_of_kinds(config: PlanConfig) -> dict[str, str]:
    """Return `code_of` the obstacles and task rows in a configuration that other packages define."""
    obstacles = code_of(obstacle_kind.OBSTACLES, (kind.name for kind in config.cell.obstacles))
    return obstacles | code_of(TASK_ROWS, (row.name for row in config.task_rows))


def plugins_of(added: Registry, names: Iterable[str]) -> dict[str, str]:
    """Return distribution and version, such as "my-package 1.2.0", of installed extensions, by "noun name".

    Args:
        added: The registry of the extensions.
        names: Names of extensions; built-in ones, and those registered in this process only, are ignored.
    """
    found = {f"{added.noun} {name}": added.distribution(name) for name in names}
    return {name: version for name, version in found.items() if version}


def plugins_of_kinds(config: PlanConfig) -> dict[str, str]:
    """Return `plugins_of` the obstacles and task rows in a configuration."""
    obstacles = plugins_of(obstacle_kind.OBSTACLES, (kind.name for kind in config.cell.obstacles))
    return obstacles | plugins_of(TASK_ROWS, (row.name for row in config.task_rows))


def _source_files(value: Any) -> list[Path]:
    """Return the sorted paths of the source files of the top-level package or module that defines an object."""
    kind = value if isinstance(value, type) else type(value)
    top = sys.modules.get(kind.__module__.partition(".")[0])
    folders = [Path(folder) for folder in getattr(top, "__path__", ())]
    module = Path(getattr(top, "__file__", None) or "")
    files = [file for folder in folders for file in folder.rglob("*.py")] or [module]
    return sorted(file for file in files if file.is_file())

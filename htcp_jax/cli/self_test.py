"""Self-test of the installation: versions, devices, rendering, caches, and a plan with a known result."""

import dataclasses
import os
import platform
import time
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from htcp_jax.caching import cache_folder, cache_key
from htcp_jax.errors import InputError
from htcp_jax.io import parts, robots
from htcp_jax.model import make_scenario
from htcp_jax.motion import Execution, Problem
from htcp_jax.planning import batch
from htcp_jax.runs import provenance
from htcp_jax.viewer import offscreen

START = (0.0, -2.3, 0.5, 0.0, 0.5, -2.0)
POINTS = 3  # number of points of the weld; with the start and the approach there are 14 targets
# Known results of the method baseline on a CPU: the last configuration, and the minimum clearance. Rounding on other
# devices and by other versions changes them by far less than TOLERANCE.
KNOWN_RAD = (-0.03942173, -1.66173581, 0.28730992, -0.10670144, 0.24431399, -2.01895122)
KNOWN_CLEARANCE_M = 0.0496996492
TOLERANCE = 1e-6  # rad, m


class SelfTest(NamedTuple):
    """Result of the self-test."""

    passed: bool
    description: str
    seconds: float
    compile_s: float  # compilation time, a part of `seconds`


def examine() -> dict[str, Any]:
    """Return data on the installation, as for `htcp doctor --json`; "sound" is True if the self-test passed."""
    folder = cache_folder.enable()
    test = self_test()
    return {
        "sound": test.passed,
        "python": platform.python_version(),
        "system": platform.platform(),
        **provenance.provenance(),
        "devices": [f"{device.platform}: {device.device_kind}" for device in jax.devices()],
        "cores": {"of_machine": os.cpu_count(), "usable": _usable_cores()},
        "rendering": _rendering(),
        "cache": None if folder is None else _contents(folder),
        "self_test": test._asdict(),
    }


def self_test() -> SelfTest:
    """Plan a short path by the method baseline, and compare the result with the known result."""
    began = time.perf_counter()
    robot, part = robots.gp50(), parts.load_workpiece()
    count = 11 + POINTS  # the start, the approach, and the path's first points
    scenario = make_scenario(robot, part, START)
    scenario = dataclasses.replace(scenario, targets=scenario.targets[:count], count=np.asarray(count, np.int32))
    problem = Problem.of(robot, part, scenario, execution=Execution(threads=1), check_paths=False)
    plans = batch.plan(problem, "baseline")
    off_rad = float(np.abs(plans.x[0, -1] - KNOWN_RAD).max())
    off_m = float(abs(plans.clearance[0].min() - KNOWN_CLEARANCE_M))
    passed = off_rad <= TOLERANCE and off_m <= TOLERANCE  # False for NaN, the value at targets that are not tracked
    description = f"{count} targets, {off_rad:.0e} rad and {1e3 * off_m:.0e} mm from the known result"
    return SelfTest(passed, description, time.perf_counter() - began, plans.compile_s)


def _rendering() -> dict[str, str | None]:
    """Return the OpenGL platform that `htcp render` uses, or the reason why there is none."""
    try:
        return {"platform": offscreen.platform(), "lacks": None}
    except InputError as error:
        return {"platform": None, "lacks": str(error)}


def _usable_cores() -> int | None:
    """Return the number of cores that this process may use; None if unknown."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()


def _contents(folder: Path) -> dict[str, Any]:
    sizes = [file.stat().st_size for file in folder.rglob("*") if file.is_file()]
    key = cache_key.preparation_key(jax.devices()[0])
    prepared = key is not None and cache_folder.read(key) is not None
    return {"folder": str(folder), "files": len(sizes), "bytes": sum(sizes), "prepared": prepared}

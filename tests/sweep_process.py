"""`htcp sweep` as a separate process that tests can kill: its folder, its command line, its output."""

import os
import re
import subprocess
import sys
import time
from pathlib import Path

from htcp_jax.runs.manifest import MANIFEST
from htcp_jax.runs.sweep import sweep

GRID = """
config: job.yaml
grid:
  - start_rad.joint3: {offsets: [-0.1, 0, 0.1]}
  - start_rad.joint4: {offsets: [0, 0.1]}
"""
# A plate behind the path, in place of the duct, too dense for any body to pass through.
PLATE = "".join(f"{x} {y / 20} {z / 20}\n" for x in (0.35, 0.4) for y in range(-6, 1) for z in range(7))
JOB = """
workpiece:
  cloud: plate.xyz
  path: path.csv
  inlet_m: [0, 0, 0]
  interior: none
  pivot_m: [1.73205679, -0.0037799, 0.57539635]
  neutral_translation_m: [1.24549547, -0.0037799, 0.87525497]
  rotation_y_rad: 0.4
  rotation_z_rad: 0.1
"""
SHARDS = 6  # one scenario each
HALF = 3
COLD = {"HTCP_CACHE": "off"}  # compiles everything first, which takes many seconds on any machine


def make_sweep(folder: Path) -> None:
    """Write a sweep of six starts in front of a plate, 13 targets each, planned in a fraction of a second."""
    (folder / "path.csv").write_text("0.1857,-0.1737,0.1708\n0.19,-0.1738,0.1705\n")
    (folder / "plate.xyz").write_text(PLATE)
    (folder / "job.yaml").write_text(JOB)
    (folder / "grid.yaml").write_text(GRID)


def command(out: str, *more: str) -> list[str]:
    """Command line of the sweep into `out`, one shard per scenario."""
    options = ["--methods", "baseline", "--shard", "1", "--out", out]
    return [sys.executable, "-m", "htcp_jax", "sweep", "grid.yaml", *options, *more]


def environment() -> dict[str, str]:
    """Environment of the caller, with this source tree on the Python path."""
    return os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])}


def start(folder: Path, out: str, *more: str, **environs: str) -> subprocess.Popen:
    """Start the sweep; `environs` are further environment variables."""
    known, pipe = environment() | environs, subprocess.PIPE
    return subprocess.Popen(command(out, *more), cwd=folder, env=known, stdout=pipe, stderr=pipe, text=True)


def plan_half(folder: Path, out: str) -> None:
    """Plan the first shards of the sweep in this process.

    A COLD process that continues from them has rows to lose and cannot end before it is disturbed.
    """
    assert sweep(folder / "grid.yaml", "baseline", folder / out, shard_scenarios=1, limit=HALF).complete


def wait_for_work(process: subprocess.Popen, run: Path) -> None:
    """Wait until a process that continues a run has rewritten its manifest."""
    before = (run / MANIFEST).stat().st_ino
    while (run / MANIFEST).stat().st_ino == before:
        assert process.poll() is None, process.communicate()
        time.sleep(0.01)


def finish(folder: Path, out: str, *more: str) -> subprocess.CompletedProcess:
    """Run the sweep to its end."""
    return subprocess.run(command(out, *more), cwd=folder, env=environment(), capture_output=True, text=True)


def without_progress(errors: str) -> list[str]:
    """Lines on stderr without the progress lines, whose number depends on the load of the machine."""
    time_left = re.compile(r" [-\d]+:[-\d]{2}(:[-\d]{2})?( left| in all)?$")
    return [line for line in errors.splitlines() if not time_left.search(line)]


def rows(folder: Path) -> dict[str, bytes]:
    """Row files of a run folder: path -> contents."""
    return {str(file.relative_to(folder)): file.read_bytes() for file in sorted(folder.glob("*/*"))}

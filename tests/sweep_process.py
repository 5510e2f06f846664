"""`htcp sweep` as a process of its own, to be killed: its folder, its command, what it leaves behind."""

import os
import subprocess
import sys
from pathlib import Path

GRID = """
config: job.yaml
grid:
  - start_rad.joint3: {offsets: [-0.1, 0, 0.1]}
  - start_rad.joint4: {offsets: [0, 0.1]}
"""
BOX = "\n".join(f"{1.3 * x} {y} {z}" for x in (0, 1) for y in (-1, 1) for z in (-1, 1))
# Where the duct stands; any other cloud stands at its own origin.
AS_THE_DUCT = (
    "pivot_m: [1.73205679, -0.0037799, 0.57539635], neutral_translation_m: [1.24549547, -0.0037799, 0.87525497], "
    "rotation_y_rad: 0.4, rotation_z_rad: 0.1"
)
SHARDS = 6  # a scenario each


def make_sweep(folder: Path) -> None:
    """Six starts in a box, a few targets each: what tracks them is tracked, the rest fails, in a fraction of a
    second."""
    (folder / "path.csv").write_text("0.1857,-0.1737,0.1708\n0.19,-0.1738,0.1705\n")
    (folder / "box.xyz").write_text(BOX)
    part = f"{{path: path.csv, cloud: box.xyz, inlet_m: [0, 0, 0], {AS_THE_DUCT}}}"
    (folder / "job.yaml").write_text(f"workpiece: {part}\n")
    (folder / "grid.yaml").write_text(GRID)


def command(out: str, *more: str) -> list[str]:
    """The command line of the sweep into `out`, a shard a scenario."""
    code = "from htcp_jax.cli import main; raise SystemExit(main())"
    options = ["--methods", "baseline", "--shard", "1", "--out", out]
    return [sys.executable, "-c", code, "sweep", "grid.yaml", *options, *more]


def environment() -> dict[str, str]:
    """The caller's, with this source tree."""
    return os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])}


def start(folder: Path, out: str, *more: str) -> subprocess.Popen:
    """The sweep, running."""
    pipe = subprocess.PIPE
    return subprocess.Popen(command(out, *more), cwd=folder, env=environment(), stdout=pipe, stderr=pipe, text=True)


def finish(folder: Path, out: str, *more: str) -> subprocess.CompletedProcess:
    """The sweep, ended by itself."""
    return subprocess.run(command(out, *more), cwd=folder, env=environment(), capture_output=True, text=True)


def rows(folder: Path) -> dict[str, bytes]:
    """The row files of a run folder."""
    return {str(file.relative_to(folder)): file.read_bytes() for file in sorted(folder.glob("*/*"))}

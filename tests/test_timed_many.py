"""A thousand scenarios of an arm with inertias, timed in one call: their memory, and each as if timed alone."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from published import MODELS, path_of
from small_cell import small_job

from htcp_jax.cli import main
from htcp_jax.runs import open_plans, open_run
from htcp_jax.runs.sweep import sweep
from htcp_jax.trajectory.plan_program import program_of

SCENARIOS, MOST_BYTES = 1000, 4 * 2**30
TIME_ALL = """
import sys
from pathlib import Path
from htcp_jax.trajectory.run_timing import time_run
from htcp_jax.runs.run_folder import open_run
time_run(open_run(sys.argv[1]), "50mm/s")
print(next(line.split()[1] for line in Path("/proc/self/status").read_text().splitlines() if "VmHWM" in line))
"""


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="the peak of memory is read from /proc")
def test_a_thousand_timed_scenarios_with_torques_stay_within_4_gib_and_each_is_as_alone(tmp_path):
    arm = tmp_path / "arm.xml"
    assert main(["robot", str(path_of("panda")), "--out", str(arm), "--tcp", MODELS["panda"].tcp]) == 0
    job, few = small_job(arm, tmp_path, MODELS["panda"].out), np.linspace(-0.002, 0.002, 10).tolist()
    grid = [{f"workpiece.shift_m.{axis}": few} for axis in "xyz"]
    sweep({"grid": grid}, "baseline", tmp_path / "run", config=job)
    out = subprocess.run([sys.executable, "-c", TIME_ALL, str(tmp_path / "run")], capture_output=True, check=True)
    peak = 1024 * int(out.stdout)  # getrusage includes the parent process
    rows = open_run(tmp_path / "run").scenarios().to_pylist()
    timed = [row for row in rows if row["torque_share"] is not None]
    assert len(rows) == SCENARIOS and len(timed) > 0.5 * SCENARIOS
    assert peak < MOST_BYTES, f"{peak / 2**30:.2f} GiB"
    plans = open_plans(tmp_path / "run")
    for row in timed[:: len(timed) // 5]:
        made = program_of(plans, 0.05, "baseline", row["scenario"])
        assert (row["torque_share"], row["torque_joint"]) == (made.peak_torque.share, made.peak_torque.joint)
        assert row["cycle_time_s"] == made.program.duration_s

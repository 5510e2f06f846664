"""`htcp prepare`: compile what the first plans of most jobs wait for."""

import tempfile
import time
import warnings
from pathlib import Path

from htcp_jax.cli.output import Device, claim_device, progress_text, stdout

JOINTS = 6, 7, 8


def prepare(device: Device = None) -> int:
    """Compile what the first plan of most jobs would wait for, once for this machine.

    For arms with six to eight joints and convex pieces of their meshes, a part from a mesh, a floor and a table, and a
    direction or a cone of the tool. Other jobs compile what they need at their first plan. Takes up to two minutes;
    again, or after an interruption, only what is missing. Writes only to the compile cache.

    \b
    Examples:
      htcp prepare                              after the installation, and after an update
    """
    claim_device(device)
    began = time.perf_counter()
    with progress_text("loading") as progress:
        from htcp_jax.caching import cache_folder
        from htcp_jax.cli.typical_jobs import plan_typical_job

        cache_folder.enable()
        for joints in JOINTS:
            progress(f"arms with {joints} joints")
            with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
                warnings.simplefilter("ignore")  # about the typical job, which is not the user's
                plan_typical_job(joints, Path(folder), device, None)
    stdout().print(f"ready for arms with 6, 7 and 8 joints, after {time.perf_counter() - began:.0f} s")
    return 0

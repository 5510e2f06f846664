"""`htcp prepare`: compile what the first plans of most jobs wait for."""

import time
import warnings
from concurrent.futures import ThreadPoolExecutor

from htcp_jax.cli.output import Device, claim_device, progress_text, stdout
from htcp_jax.system import temporary_folder

JOINTS = 6, 7, 8


def prepare(device: Device = None) -> int:
    """Compile what the first plan of most jobs would wait for, once for this machine.

    For arms with six to eight joints and convex pieces of their meshes, a part from a mesh, a floor and a table, and a
    direction or a cone of the tool. Other jobs compile what they need at their first plan. Takes two minutes on two
    cores; again, or after an interruption, only what is missing. Writes only to the compile cache.

    \b
    Examples:
      htcp prepare                              after the installation, and after an update
    """
    claim_device(device)
    began = time.perf_counter()
    with progress_text("arms with 6, 7 and 8 joints"), temporary_folder() as folder:
        from htcp_jax.caching import cache_folder
        from htcp_jax.cli.typical_jobs import typical_plan

        cache_folder.enable()
        folders = [folder / str(joints) for joints in JOINTS]
        for each in folders:
            each.mkdir()
        pool = ThreadPoolExecutor(len(JOINTS))  # compiled together, so that no core waits for the last function of one
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # about the typical jobs, which are not the user's
                plans = list(pool.map(typical_plan, JOINTS, folders, [device] * len(JOINTS)))
                for plan, own in zip(plans, folders, strict=True):
                    plan.write(own)
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
    stdout().print(f"ready for arms with 6, 7 and 8 joints, after {time.perf_counter() - began:.0f} s")
    return 0

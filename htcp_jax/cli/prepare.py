"""`htcp prepare`: compile what the first plans of many jobs wait for."""

import signal
import time
import warnings

from htcp_jax.cli.output import Device, claim_device, progress_text, stdout
from htcp_jax.device import COMPILATIONS
from htcp_jax.errors import InputError, Interrupted
from htcp_jax.system import stop_message, temporary_folder

STOPPED = "stopped; the programs compiled so far are kept: htcp prepare goes on from them"


def prepare(device: Device = None) -> int:
    """Compile what the first plan of many jobs would wait for, once for this machine.

    For arms with six to eight joints and convex pieces of their meshes, a part from a mesh, planes and boxes, and a
    direction or a cone of the tool; docs/installation.md has their sizes. Other jobs compile what they need at their
    first plan. Takes over two minutes on two cores; again, or after an interruption, only what is missing. Writes only
    to the compile cache.

    Exit codes: 0, 2 on bad input, 130 or 143 after a signal.

    \b
    Examples:
      htcp prepare                              after the installation, and after an update
    """
    claim_device(device)
    began = time.perf_counter()
    text = "arms with 6, 7 and 8 joints, over two minutes on two cores"
    with COMPILATIONS.growing(), progress_text(text), temporary_folder() as folder:
        from htcp_jax.caching import cache_folder, cache_key
        from htcp_jax.cli.typical_jobs import typical_plans
        from htcp_jax.device import devices

        if cache_folder.enable() is None:
            raise InputError("there is no cache folder to compile for: set HTCP_CACHE to a folder, or unset it")
        with warnings.catch_warnings(), stop_message(lambda: STOPPED):
            warnings.simplefilter("ignore")  # about the typical jobs, which are not the user's
            try:
                for plan in typical_plans(folder, device):
                    plan.write(folder)
            except KeyboardInterrupt:
                raise Interrupted(STOPPED, signal.SIGINT) from None
        if key := cache_key.preparation_key(devices.choose(device)[0]):
            cache_folder.write(key, b"")
    seconds = time.perf_counter() - began
    stdout().print(f"ready for arms with 6, 7 and 8 joints: {COMPILATIONS.done} programs compiled in {seconds:.0f} s")
    return 0

"""Entry point of `htcp` and of `python -m htcp_jax`. It installs signal handlers before it imports JAX."""

import gc
import os
import signal
import sys
from typing import NoReturn

OBJECTS = 100_000  # new objects after which Python collects garbage: imports create a million that remain


def _command() -> int:
    gc.set_threshold(OBJECTS)
    from htcp_jax.cli import main  # here, as the import takes a second

    return main()


def _end_at_once(number: int, _) -> NoReturn:
    """End the process at a signal before anything is written, without Python's traceback."""
    os.write(2, b"htcp: interrupted\n")
    os._exit(128 + number)


def main() -> NoReturn:
    """Run the command line and end the process with its exit code."""
    if signal.getsignal(signal.SIGINT) != signal.SIG_IGN:
        signal.signal(signal.SIGINT, _end_at_once)  # until `run` installs its handlers
    # XLA's own messages, such as its alarm about a compilation above 2 minutes; its errors are exceptions of JAX.
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    from htcp_jax.system import run  # here, as the import takes a tenth of a second

    run(_command)


if __name__ == "__main__":
    sys.exit(main())

"""Entry point of `htcp` and of `python -m htcp_jax`. It installs signal handlers before it imports JAX."""

import gc
import sys
from typing import NoReturn

from htcp_jax.system import run

OBJECTS = 100_000  # new objects after which Python collects garbage: imports create a million that remain


def _command() -> int:
    gc.set_threshold(OBJECTS)
    from htcp_jax.cli import main  # here, as the import takes a second

    return main()


def main() -> NoReturn:
    """Run the command line and end the process with its exit code."""
    run(_command)


if __name__ == "__main__":
    sys.exit(main())

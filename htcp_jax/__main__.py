"""The command `htcp`, which is `python -m htcp_jax`. Signals are handled before anything large is imported."""

import sys
from typing import NoReturn

from htcp_jax.process_exit import run


def _command() -> int:
    from htcp_jax.cli import main  # here, as it takes a second

    return main()


def main() -> NoReturn:
    """Run the command line and end the process with its exit code."""
    run(_command)


if __name__ == "__main__":
    sys.exit(main())

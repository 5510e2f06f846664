"""`python -m htcp_jax`, which is the command `htcp`."""

from htcp_jax.cli.main import main

raise SystemExit(main())

"""The command `htcp`: one module per command, which is imported when it is called.

`main` runs the command line and returns its exit code; bad input gives one line and code 2. Its module lists the
commands with their lines of help, so that `htcp --help` imports none of them.

A command's function is named like its module. It reads options, calls the packages below, and prints by `output`:
tables, progress bars, or JSON with `--json`. `doctor` and `self_test` check the installation. Nothing else imports from
this package.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

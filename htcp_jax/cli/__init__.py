"""The command `htcp`: one module per command, which is imported when the command is called.

`main` runs the command line and returns its exit code. For invalid input it prints one line and returns 2. The module
`main` lists the commands with one line of help each, so that `htcp --help` imports no command.

A command's function has the name of its module. It reads options and calls the other packages. It prints tables,
progress bars or, with `--json`, JSON by functions of the module `output`. No other package imports from this one.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

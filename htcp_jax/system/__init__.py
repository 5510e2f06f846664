"""Files, locks, signals and the end of a process, by the standard library alone.

`files` reads and writes files that may be untrusted; `output_files` writes results completely or not at all.
`unfinished` marks files and folders that are being written, `lock` holds the folder of a run, and `process_exit` ends
the process and its children when a signal arrives.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

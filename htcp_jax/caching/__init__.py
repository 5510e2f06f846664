"""Results and executables that are kept on disk for later processes.

`cache_folder` is the folder with its size limit, `cache_key` makes the names of its files from what determines their
contents, and `cached_by_values` and `cached_for_last` are decorators that keep a function's results.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

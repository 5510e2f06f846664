"""Compiled functions and the devices that run them.

`lane_function` declares a function of one lane (a row of a batch), the settings that it reads, and how many of its rows
run together: a `lane_function.LaneFunction`. `Executor` are all of them, compiled for one scene on one device and
called with tables, one row per lane. A function that takes some steps returns a `Loop`: a CPU advances it lane by lane,
a GPU all lanes side by side. `by_chunks` runs such a loop for joint paths that are divided further and further. A row's
result does not depend on the other rows of its batch.

`devices` chooses CPU or GPU and the number of threads, `processes` shares scenarios among worker processes,
`compile_cache` is the folder of compiled programs, which `EXECUTABLES` loads without tracing, and `tables` has
functions for tables of arrays with one row per lane: gather, scatter, concatenate.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

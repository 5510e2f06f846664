"""Compiled functions and the devices that run them.

A `lane_function.LaneFunction` declares a function of one lane (a row of a batch), the settings that it reads, and the
number of rows that run together. An `Executor` compiles lane functions for one scene on one device, and calls them with
tables, one row per lane. A function whose number of steps varies returns a `Loop`: a CPU runs it lane by lane, a GPU
runs it for many lanes side by side. `by_chunks` runs such a loop for joint paths that are bisected. A row's result does
not depend on the other rows of its batch.

`devices` chooses CPU or GPU and the number of threads, and `processes` shares scenarios among worker processes.
`compilations` counts the programs that are being compiled. `kept_executables` stores compiled programs in the cache
folder, and loads them without tracing. `tables` has functions for tables of arrays with one row per lane: gather,
scatter, concatenate.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""Runs: plans and sweeps on disk, computed on this machine or a cluster.

A run folder holds a manifest, which states its inputs, and shards of results, each written completely or not at all.
`sweep` plans missing shards and reports a `RunningSummary`; `open_run` opens the folder as a `Run`, and `tables` turns
its rows into frames. `open_plans` opens whatever has plans, a run, a search or one plan's folder, as a `PlanSet`;
`open` has the kinds of it. `plan_folder` is the folder of one plan.

Files of a run folder, a module each: `manifest`, `timing_file`, `reachability_file`. What identifies a run: `identity`
hashes its configuration, `input_files` the files that it reads, `provenance` names the program and the machine.
`parameters` are the numbers of each scenario, and `labels` name them in words. `summary` and `motion_summary` count
and measure plans. `lock` keeps a second program out of a folder.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

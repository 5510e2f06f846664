"""Runs: plans and sweeps on disk, computed on this machine or a cluster.

A run folder contains a manifest, which describes the run's inputs, and shards of results, each written atomically.
`sweep` plans the missing scenarios; `shards` cuts them into blocks of about a minute, `written_run` writes these in a
thread, and a `RunningSummary` collects them in memory. `open_run` opens a run folder as a `Run`. `tables` converts
plans to rows of the run's tables, and rows to frames. `open_plans` opens the folder of a run, of a placement search or
of one plan as a `PlanSet`; the module `open` defines the kinds of plan sets. `plan_folder` reads and writes the folder
of one plan. `checkpoint` keeps the results of a reachability search while it runs.

`manifest`, `timing_file` and `reachability_file` read files of a run folder. `identity` hashes a run's configuration,
`input_files` hashes the files that the run reads, and `provenance` names the program and the machine. `parameters`
defines the numbers that vary between scenarios, and `labels` formats them as text. `summary` and `motion_summary`
summarise plans.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

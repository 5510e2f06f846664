"""Runs: plans and sweeps on disk, computed on this machine or a cluster.

A run folder contains a manifest, which states its inputs, and shards of results, each written completely or not at all.
`sweep` plans missing shards, `run_folder.open_run` opens a run. `plan_folder` is the folder of one plan.
"""

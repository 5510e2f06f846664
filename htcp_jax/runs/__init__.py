"""Runs: plans and sweeps on disk, on this machine or a cluster.

A run folder holds a manifest, which states its inputs, and shards of results, each written completely or not at all;
`sweep` plans what is missing, `open.open_run` opens what is there. `plan_folder` is the folder of one plan.
"""

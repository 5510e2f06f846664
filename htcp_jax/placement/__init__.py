"""Placement optimisation: ranges of a job's parameters, and the mountings in them that complete the path, ranked.

`place_file` reads a search, `search` proposes mountings, `judge` plans them, `tolerance` plans them under perturbation,
`placed` is the ranking on disk.
"""

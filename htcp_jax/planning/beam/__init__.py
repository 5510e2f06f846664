"""Beam search over configurations: several configurations per target are extended to the next target, the best kept.

`beam` is the search, and `functions` has its computations on the device. `searches` has the state of all searches,
`tree` their configurations. `dead_ends` searches backwards after a dead end. `record` converts the results into plans.
"""

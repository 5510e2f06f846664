"""Beam search over configurations: several configurations per target, extended to the next target and thinned.

`beam` is the search, `functions` its computations on the device, `searches` the candidates of every scenario, `record`
converts the results into plans.
"""

"""Beam search over configurations: several configurations per target, extended to the next target and thinned.

`beam` is the search, `functions` what it computes on the device, `searches` the candidates of every scenario, `record`
what becomes a plan.
"""

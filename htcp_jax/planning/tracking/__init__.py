"""Path tracking by step QPs, with recoveries that move in the null space of the task (Algorithm 1 of the paper).

`StepQPs` is the base class of these methods: a method has a solver of the step QPs, and recoveries in the order in
which they are tried. It plans by an `Engine`, which advances a batch of scenarios in different phases; `lanes` is the
engine's table with one row per scenario or candidate. `stages` has the recoveries: null-space steps, random samples, a
push away from the nearest obstacle. `null_space` has one null-space step and its objective (equation (11)).

The other modules are parts of the engine: shared work, candidates, planning backwards, records.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""Path tracking by step QPs, with recoveries that move in the null space of the task (Algorithm 1 of the paper).

`StepQPs` is the method: which solver solves the step QPs, and which recoveries are tried, in which order. It plans by
an `Engine`, which advances a batch of scenarios, whatever phase each of them is in; `lanes` is the engine's table with
one row per scenario or candidate. `stages` are the recoveries: null-space steps, random samples, a push away from the
nearest obstacle. `null_space` is one null-space step and its objective (equation (11)).

The other modules are the engine's parts: work still to be done, candidates, plans backwards, records.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

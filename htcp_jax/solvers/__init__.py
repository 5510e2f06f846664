"""Solvers of the optimisation problems in planning: step QPs, null-space directions, smoothing.

`step_qp` defines the convex program of one step, `StepQP` (equation (9) of the paper), and assembles it at a
configuration. `active_set` solves it inside compiled functions. On the host a `step_qp.QPSolver` solves it:
`ClarabelSolver`, or `QPSolversSolver` for any solver of the library qpsolvers. All solvers return a
`step_qp.QPSolution` with a `step_qp.QPStatus`; the setting `qp` selects the solver.

`sphere` maximises the null-space objective on the unit sphere of directions (equation (11)): by SQP, interior point,
Adam or CMA-ES (module `cma_es`). `path_qp` is the QP over a complete path that smooths motions (equation (3));
`banded_qp` solves it on the host.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

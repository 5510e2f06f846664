"""Solvers of the small problems that a plan consists of.

`step_qp` states the convex program of one step (equation (9) of the paper), `StepQP`, and assembles it at a
configuration. Anything that solves it is a `step_qp.QPSolver`: `active_set` runs inside compiled functions,
`ClarabelSolver` on the host, `QPSolversSolver` passes it to any solver of the library qpsolvers. All of them return a
`step_qp.QPSolution` with a `step_qp.QPStatus`, and a method chooses one by the setting `qp`.

`sphere` maximises the null-space objective on the unit sphere of directions (equation (11)): by SQP, interior point,
Adam or CMA-ES, the last of which is the module `cma_es`. `path_qp` is the program over a complete path by which motions
are smoothed (equation (3)).
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

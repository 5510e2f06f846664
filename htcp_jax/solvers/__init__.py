"""Solvers of the small problems that a plan consists of.

`step_qp` states the convex program of one step (equation (8) of the paper) and passes it to a solver: Clarabel, an
active-set method or an interior-point method that run inside compiled functions, or any solver of qpsolvers. `sphere`
maximises the null-space objective on the unit sphere of directions: SQP, interior point, Adam, CMA-ES. `path_qp` is the
quadratic program over a complete path by which motions are smoothed.
"""

"""The small problems, and what solves them: the step QP, the sphere of null-space directions, CMA-ES."""

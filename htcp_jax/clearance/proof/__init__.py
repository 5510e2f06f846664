"""Proofs about motions: lower bounds on clearance and bounds on task errors between two configurations.

Each module begins with the inequality that it implements. `motion_proof` proves or refutes that a segment is clear,
`row_proof` that it stays on the path, `exclusion` that no configuration reaches a target.
"""

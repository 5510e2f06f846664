"""Independent validation of results by MuJoCo, and comparison of runs with baselines.

`validate_results` checks the tracked targets and segments of a plan or a run by MuJoCo's kinematics and distances,
without the planner's code. It returns a `Validation` with the refuted configurations and the largest deviations.
Segments are sampled at joint steps of at most `STEP_RAD`. `write_validation` saves the result. `check_timed` checks a
timed motion.

A `Baseline` is a file with the expected results of a run: `read_baseline` reads it, `update_baseline` writes it, and
the module `gate` compares a run with it.

To stay independent, this package imports only data types, file readers and constants from other packages;
`tests/lint.py` lists them.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

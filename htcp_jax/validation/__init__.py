"""Independent validation: results measured again by MuJoCo, and comparison with baselines.

`validate` measures tracked targets and segments of a plan or a run by MuJoCo's own distances and kinematics and uses
none of the planner's mathematics. It returns a `Validation`: violations by kind, and the largest deviations.
Segments are sampled at steps of `STEP_RAD`. `record` and `write_validation` save it, and `check_timed` does the same
for a timed program.

A `Baseline` is a file of a run's expected counts: `read_baseline` reads it, `update` writes it, and `gate` compares
another run with it.

`tests/lint.py` lists the names that this package may import from others: types of data, files, constants.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

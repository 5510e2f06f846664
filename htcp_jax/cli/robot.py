"""`htcp robot`: convert a vendor's URDF or MJCF to an arm of capsules."""

import math
import os
import warnings
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from htcp_jax.clearance.obstacles import make_self_collision
from htcp_jax.cli.output import Json, print_facts, print_json, print_table, progress_bar, stdout
from htcp_jax.cli.quantities import LENGTHS, quantity
from htcp_jax.errors import InputError
from htcp_jax.io import robots
from htcp_jax.io.robots import Listed, arm_xml, capsule_fit, close_fit, fixed_text, follower_text, shapes_label
from htcp_jax.model import Robot, kinematics
from htcp_jax.report import Table
from htcp_jax.runs import columns
from htcp_jax.system import output_files

LARGEST_M = 100.0  # larger arms are usually in millimetres
COLUMNS = "body", "own", "fitted", "volume_ratio", "excess_mm", "outside_mm", "shapes"

Model = Annotated[Path, typer.Argument(metavar="MODEL", help="URDF or MJCF file, with its meshes next to it.")]
Tcp = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="Site or body at the TCP. Default: tcp or tool0, else the only site, else the last body of an unbranched "
        "chain; otherwise required.",
    ),
]
Out = Annotated[Path, typer.Option(metavar="ARM.xml", help="Output file; a picture is written next to it.")]
Most = Annotated[
    int | None,
    typer.Option(
        metavar="N",
        min=1,
        max=20,
        help=f"Maximum number of capsules fitted to a body, before pieces are cut closer. Default: {capsule_fit.MOST}; "
        "if --fit-tolerance is given, "
        f"{close_fit.MOST_CLOSE} on the last two links and the tool, {close_fit.MOST} on the others.",
    ),
]
FitTolerance = Annotated[
    str | None,
    typer.Option(
        metavar="LENGTH",
        help="Fit more capsules to the last two links and the tool, until 95 % of the capsules' surface is this close "
        "to the mesh, for example 5mm.",
    ),
]
Visual = Annotated[bool, typer.Option("--visual", help="Enclose the visual meshes instead of the collision geometry.")]
Srdf = Annotated[Path | None, typer.Option(metavar="FILE", help="SRDF file with disabled collision pairs.")]
Fix = Annotated[
    list[str] | None,
    typer.Option("--fix", metavar="JOINT=VALUE", help="Freeze a joint at a value [rad or m]; may be repeated."),
]
Omit = Annotated[
    list[str] | None,
    typer.Option(metavar="LINK", help="Link without capsules: a cable, the part. May be repeated."),
]
Limits = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="File with joint limits, such as MoveIt's joint_limits.yaml; its ranges, speeds and accelerations replace "
        "the model's.",
    ),
]
Replace = Annotated[bool, typer.Option("--replace", help="Overwrite existing files.")]
Verbose = Annotated[
    bool, typer.Option("--verbose", help="List all elements and attributes of the model that are not used.")
]


def robot(
    model: Model,
    out: Out,
    tcp: Tcp = None,
    omit: Omit = None,
    most: Most = None,
    fit_tolerance: FitTolerance = None,
    visual: Visual = False,
    srdf: Srdf = None,
    fix: Fix = None,
    limits: Limits = None,
    replace: Replace = False,
    verbose: Verbose = False,
    as_json: Json = False,
) -> int:
    """Convert a vendor's URDF or MJCF model to an arm of capsules.

    The joints from base to TCP stay movable, with joints that follow them, such as those of a linkage's rods. All
    others, such as a gripper's, are frozen; --fix freezes further ones.
    Each revolute or prismatic joint of a URDF needs a range, in the model or in --limits FILE.
    Capsules and spheres of the model are kept; fitted capsules enclose meshes, boxes and cylinders. Writes ARM.xml and
    ARM.png. Inspect the picture: it shows the capsules over the model, coloured by their distance from the mesh, and
    below the convex pieces, which decide where the capsules come too near.
    ARM.xml contains, for each fitted capsule, the convex hull of the mesh inside it. It also lists the pairs of
    capsules that are not checked for self-collision, with the reason: disabled by the model or the SRDF file, nearly
    always overlapping, or overlapping although the meshes inside do not touch. If the arm is clear much less often by
    its pieces than by its meshes, the pieces of the pairs that make the difference are cut closer.

    Exit codes: 0, 2 on bad input or if ARM.xml exists.

    \b
    Examples:
      htcp example pipe pipe                                 copy an example with a model: pipe/arm.xml
      htcp robot pipe/arm.xml --out arm.xml
      htcp robot pipe/arm.xml --tcp link7 --most 5 --out flange.xml
      htcp robot panda.urdf --tcp panda_hand --fit-tolerance 5mm --out panda.xml
      htcp robot pipe/arm.xml --fix a3=0.2 --out six.xml
      htcp robot arm.urdf --limits joint_limits.yaml --out arm.xml
    """
    options = {"most": most, "visual": visual, "srdf": srdf, "omit": omit or (), "limits": limits}
    return convert(model, out, fix or (), fit_tolerance, replace, as_json, verbose, tcp=tcp, **options)


def convert(
    model: Path,
    out: Path,
    fix: Iterable[str],
    fit_tolerance: str | None,
    replace: bool,
    as_json: bool,
    verbose: bool = False,
    **options: Any,
) -> int:
    """Import a model, write it with its picture, and print its bodies and joints.

    Args:
        model: The vendor's model.
        out: The file to write.
        fix: Joints to freeze, each JOINT=VALUE.
        fit_tolerance: Value of --fit-tolerance, with its unit; None if it is not set.
        replace: True overwrites existing files.
        as_json: True prints JSON instead of a table.
        verbose: True lists all elements and attributes that are not used.
        **options: Arguments passed on to `robots.import_robot`.

    Returns:
        The exit code.
    """
    fixed, tolerance_m = _fixed_values(fix), tolerance_m_of(fit_tolerance)
    picture = picture_of(out, replace)
    with progress_bar("bodies") as progress:
        arm = robots.import_robot(model, tolerance_m=tolerance_m, fixed=fixed, progress=progress, **options)
    source = os.path.relpath(model, out.parent)
    from htcp_jax.viewer import draw_arm  # here, after checks of the input, as the import is slow

    with output_files.written_whole(out.parent) as folder:

        def load(arm: robots.ImportedArm, listed: Sequence[Listed] | None = None) -> Robot:
            output_files.write_text(folder / out.name, arm_xml(arm, source, listed))
            return robots.load_robot(folder / out.name, fewest_joints=1)

        with progress_bar("pairs of capsules") as progress:
            checked = robots.check_arm(arm, load, progress)
        with progress_bar("pictures"):
            first, arm = arm, checked.arm
            made = load(arm, checked.listed)
            own = make_self_collision(made)
            carried = "" if arm.part is None else f", part on {arm.part}"
            shown = f"{len(made.joint_names)} joints, {len(made.capsule_names)} capsules; TCP {arm.tip.name}{carried}"
            title = f"{made.name}: {shown}"
            draw_arm(arm, (folder / out.name).read_text(encoding="utf-8"), title).savefig(folder / picture.name)
    table, facts = bodies_table(arm), _robot_facts(arm, made)
    facts["self-collision"] = own.described(made) if own else "no pairs to check"
    shares = checked.shares
    facts["clear"] = shares.described()
    if closer := checked.closer_than(first):
        facts["cut closer"] = closer
    if verbose:
        facts["not used"] = arm.unused
    if as_json:
        pairs = {"differing": list(map(str, shares.differing)), "overlapping": list(map(str, shares.usual))}
        facts["clear"] = {"pieces": shares.pieces, "meshes": shares.meshes, **pairs}
        print_json({"model": made.name, **facts, "bodies": table.records(), "files": [str(out), str(picture)]})
        return 0
    print_table(stdout(), table)
    lines = {name: ", ".join(value) if isinstance(value, tuple) else value for name, value in facts.items() if value}
    print_facts(title, lines | {"files": f"{out}, {picture}"})
    return 0


def picture_of(out: Path, replace: bool) -> Path:
    """Return the file of the picture next to an output file.

    Raises:
        InputError: For an ending other than .xml, and for a file that exists, unless it is to be replaced.
    """
    if out.suffix.lower() != ".xml":
        raise InputError(f"--out is {out}; the output is an MJCF file, whose name must end in .xml")
    picture = out.with_suffix(".png")
    for file in (out, picture):
        if file.exists() and not replace:
            raise InputError(f"{file} exists; pass --replace to overwrite it, manual changes included")
    return picture


def _fixed_values(options: Iterable[str]) -> dict[str, float]:
    """Return the values of the options `--fix JOINT=VALUE` by joint [rad or m].

    Raises:
        InputError: If an option is not JOINT=VALUE with a finite number, or if a joint is repeated.
    """
    values: dict[str, float] = {}
    for option in options:
        name, _, text = option.rpartition("=")
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not name or not math.isfinite(value):
            raise InputError(f"--fix {option}: it must be JOINT=VALUE with a number, in rad or m")
        if name in values:
            raise InputError(f"--fix {option}: {name} is fixed twice")
        values[name] = value
    return values


def tolerance_m_of(text: str | None) -> float | None:
    """Return the value of `--fit-tolerance` [m]; None if it is not set.

    Raises:
        InputError: If the text is not a length, or if the length is out of range.
    """
    if text is None:
        return None
    low, high = close_fit.TOLERANCES_M
    valid = f"a length of {1e3 * low:g}mm to {1e3 * high:g}mm"
    return quantity("--fit-tolerance", text, {**LENGTHS, "": 1.0}, "5mm", valid, low, high)


def bodies_table(arm: robots.ImportedArm) -> Table:
    """Return the table of an imported model's bodies, with the fit of their capsules."""
    rows = []
    for b, cover in arm.covers.items():
        counts = len(cover.own), len(cover.fitted)
        rows.append(
            (
                robots.body_name(arm.model, b),
                *counts,
                cover.ratio,
                1e3 * cover.excess_m,
                1e3 * cover.outside_m,
                shapes_label(cover),
            )
        )
    return Table("robot", columns.of(*COLUMNS), tuple(rows))


def _robot_facts(arm: robots.ImportedArm, made: Robot) -> dict[str, str | tuple[str, ...]]:
    return {
        "TCP": arm.tip.name,
        **({} if arm.part is None else {"part": arm.part, "chain": robots.chain_text(arm)}),
        "joints": made.joint_names,
        **_limits(made),
        **({"reach": reach_text(made)} if arm.part is None else {}),
        **({"followers": follower_text(arm)} if arm.followers else {}),
        "frozen": arm.frozen,
        "fixed": fixed_text(arm),
        "without a shape": arm.shapeless,
        "excluded": arm.excluded,
        **({"omitted": arm.omitted} if arm.omitted else {}),
    }


def reach_text(made: Robot) -> str:
    """Return text about the arm's reach and its longest capsule; warn if one seems to be in millimetres."""
    p, q, radius = (np.asarray(each) for each in (made.capsule_p, made.capsule_q, made.capsule_radius))
    reach_m, lengths_m = kinematics.max_reach(made), np.linalg.norm(q - p, axis=1) + 2 * radius
    text = f"the TCP is at most {reach_m:.3g} m from the first joint"
    if len(lengths_m):
        text += f"; the longest capsule, {made.capsule_names[int(lengths_m.argmax())]}, is {lengths_m.max():.3g} m long"
    if LARGEST_M < max(reach_m, lengths_m.max(initial=0.0)) < math.inf:
        warnings.warn(f"{made.name}: {text}: lengths seem to be in millimetres", stacklevel=2)
    return text


def _limits(made: Robot) -> dict[str, str]:
    """Return text about the joints' ranges and full speeds; no speeds if the model states none."""
    slides = made.sliding
    size = np.where(slides, 1e3, np.rad2deg(1.0))
    ranges = [f"{low:.4g} to {high:.4g}" for low, high in zip(size * made.lower, size * made.upper, strict=True)]
    speeds = [f"{each:.4g}" for each in size * np.asarray(made.speed)]
    texts = {"ranges": _with_units(ranges, slides, "")}
    return texts | ({"full speeds": _with_units(speeds, slides, "/s")} if np.isfinite(made.speed).any() else {})


def _with_units(values: Sequence[str], slides: Sequence[bool], per: str) -> str:
    """Join values of joints, with one unit at the end if they have the same."""
    units = [f" {'mm' if slide else 'deg'}{per}" for slide in slides]
    if len(set(units)) == 1:
        return ", ".join(values) + units[0]
    return ", ".join(map("".join, zip(values, units, strict=True)))

"""`htcp tool`: convert a torch's mesh to a tool of capsules for a job, and check the tool of a job."""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from jaxtyping import Float

from htcp_jax.cli import tool_check
from htcp_jax.cli.output import Json, Overrides, print_facts, print_json, print_table, progress_bar, stdout
from htcp_jax.cli.quantities import ANGLES, LENGTHS, quantity, vector
from htcp_jax.cli.robot import FitTolerance, Most, Replace, bodies_table, picture_of, tolerance_m_of
from htcp_jax.errors import InputError
from htcp_jax.io import robots
from htcp_jax.io.parts import PER_METRE
from htcp_jax.spec import tool as tools
from htcp_jax.system import output_files

FILE_UNITS = {unit: 1 / number for unit, number in PER_METRE.items()}  # of a mesh [m]

JOBS = ".yaml", ".yml"

File = Annotated[
    Path,
    typer.Argument(
        metavar="MESH|JOB.yaml",
        help="The tool's mesh (.stl .obj .ply .step), with its origin on the flange, z out of it; or a job to check.",
    ),
]
Out = Annotated[Path | None, typer.Option(metavar="TOOL.xml", help="Output file; a picture is written next to it.")]
Tip = Annotated[
    str | None,
    typer.Option(
        metavar="X,Y,Z", help="The tip in the mesh's frame, in the mesh's unit, or with a unit: 106.1,0,366.1mm."
    ),
]
Unit = Annotated[
    str | None,
    typer.Option(metavar="UNIT", help="Unit of the mesh: m, mm, cm, in. Default: m, or the unit that the file states."),
]
Direction = Annotated[
    str | None,
    typer.Option(metavar="X,Y,Z", help="Direction out of the nozzle: z of the TCP. Default: 0,0,1, the flange's z."),
]
Rpy = Annotated[
    str | None,
    typer.Option(
        "--rpy",
        metavar="R,P,Y",
        help="In place of --direction: roll, pitch, yaw of the TCP, as tip_rpy_rad in a job; in rad, or with a unit: "
        "0,45,0deg.",
    ),
]
Quaternion = Annotated[
    str | None, typer.Option(metavar="W,X,Y,Z", help="In place of --direction: orientation of the TCP.")
]
Stickout = Annotated[
    str | None,
    typer.Option(
        metavar="LENGTH", help="Bare wire beyond --tip, for example 12mm: the TCP is this far out of the nozzle."
    ),
]


def tool(
    file: File,
    tip: Tip = None,
    out: Out = None,
    unit: Unit = None,
    direction: Direction = None,
    rpy: Rpy = None,
    quaternion: Quaternion = None,
    stickout: Stickout = None,
    most: Most = None,
    fit_tolerance: FitTolerance = None,
    replace: Replace = False,
    overrides: Overrides = None,
    as_json: Json = False,
) -> int:
    """Convert the mesh of a torch to a tool of capsules; or check the tool of a job before it is planned.

    Capsules and convex pieces enclose the mesh, as with htcp robot. The mesh's origin is put on the flange, with z out
    of it; a job's tool.base_m and tool.base_rpy_rad move it. The TCP is --tip, or --stickout beyond it, and z of the
    TCP points out of the nozzle. Writes TOOL.xml and TOOL.png. In a job:

    \b
      tool: {model: TOOL.xml, parent: robot.FLANGE}    FLANGE: a link or site of the robot, such as tool0

    The tip is on the path, and all bodies must have the clearance margin_m. So the mesh must end before the TCP: delete
    the wire from it.

    With a job, only --set and --json apply. At each target the tool alone, without the arm, is turned through the
    angles that the task allows. Prints where it clears the part's cloud or mesh by margin_m, the minimum clearance, and
    how it changes if the wire is longer, that is, if the TCP is farther out of the nozzle.

    Exit codes: 0, 2 on bad input or if TOOL.xml exists, 3 if the tool does not clear the part at every target.

    \b
    Examples:
      htcp tool torch.stl --unit mm --tip 92,0,352 --direction 1,0,1 --stickout 15mm --out torch.xml
      htcp tool torch.stl --unit mm --tip 106,0,366 --rpy 0,45,0deg --out torch.xml
      htcp tool grinder.step --tip 0,0,210mm --fit-tolerance 2mm --out grinder.xml
      htcp tool job.yaml                                 does the tool clear the part?
    """
    if file.suffix.lower() in JOBS:
        given = {"--tip": tip, "--out": out, "--unit": unit, "--direction": direction, "--rpy": rpy}
        given |= {"--quaternion": quaternion, "--stickout": stickout, "--most": most, "--fit-tolerance": fit_tolerance}
        given |= {"--replace": replace or None}
        if names := [name for name, value in given.items() if value is not None]:
            raise InputError(f"{names[0]} applies to a mesh; {file} is a job, whose own tool is checked")
        return tool_check.check_job(file, overrides or (), as_json)
    if not file.suffix:
        raise InputError(f"{file} is neither a mesh, such as torch.stl, nor a job, such as job.yaml")
    if overrides:
        raise InputError(f"--set applies to a job, whose file ends in {' or '.join(JOBS)}; this is {file}")
    if tip is None or out is None:
        raise InputError(f"{'--tip' if tip is None else '--out'} is missing; example: --tip 92,0,352 --out torch.xml")
    picture = picture_of(out, replace)
    tolerance_m = tolerance_m_of(fit_tolerance)
    if unit is not None and unit not in FILE_UNITS:
        raise InputError(f"--unit {unit}: valid are {', '.join(FILE_UNITS)}")
    T_mesh_tcp = _tcp(tip, unit or "m", direction, rpy, quaternion)
    if stickout is not None:
        T_mesh_tcp[:3, 3] += quantity("--stickout", stickout, LENGTHS | FILE_UNITS, "12mm") * T_mesh_tcp[:3, 2]
    with progress_bar("capsules"):
        made = robots.import_tool(file, T_mesh_tcp, unit, most=most, tolerance_m=tolerance_m)
    from htcp_jax.viewer import draw_arm  # here, after checks of the input, as the import is slow

    (cover,) = made.covers.values()
    title = f"{made.name}: {len(cover.fitted)} capsules; TCP {_text_mm(T_mesh_tcp[:3, 3])}"
    with progress_bar("pictures"), output_files.written_whole(out.parent) as folder:
        text = robots.arm_xml(made, file.name)
        output_files.write_text(folder / out.name, text)
        draw_arm(made, text, title).savefig(folder / picture.name)
    bare_m, table = robots.bare_length_m(made), bodies_table(made)
    length_m = float(np.linalg.norm(T_mesh_tcp[:3, 3]))
    if as_json:
        facts = {"tcp_m": T_mesh_tcp[:3, 3].tolist(), "direction": T_mesh_tcp[:3, 2].tolist(), "length_m": length_m}
        files = [str(out), str(picture)]
        print_json({"tool": made.name, **facts, "bare_m": bare_m, "bodies": table.records(), "files": files})
        return 0
    print_table(stdout(), table)
    print_facts(
        title,
        {
            "length": f"{1e3 * length_m:.1f} mm from the flange to the TCP",
            "direction": f"({', '.join(f'{each:.3f}' for each in T_mesh_tcp[:3, 2] + 0.0)}) out of the tool",
            "bare tip": _bare_text(bare_m),
            "in a job": f"tool: {{model: {out}, parent: robot.FLANGE}}, with the name of the robot's flange",
            "files": f"{out}, {picture}",
        },
    )
    return 0


def _tcp(
    tip: str, unit: str, direction: str | None, rpy: str | None, quaternion: str | None
) -> Float[np.ndarray, "4 4"]:
    """Return the pose of the tip in the mesh's frame [m].

    Raises:
        InputError: For values that are not numbers, a direction of length 0, and for two orientations.
    """
    position = vector("--tip", tip, FILE_UNITS, unit, 3, "92,0,352")
    given = {"--direction": direction, "--rpy": rpy, "--quaternion": quaternion}
    if len(both := [name for name, text in given.items() if text is not None]) > 1:
        raise InputError(f"{both[0]} and {both[1]} both state the orientation; give one of them")
    if rpy is not None:
        angles = vector("--rpy", rpy, ANGLES, "rad", 3, "0,45,0deg")
        if np.abs(angles).max() > 2 * np.pi:
            raise InputError(f"--rpy {rpy}: above 6.28 rad; did you mean {rpy}deg?")
        return tools.pose(tuple(position), tuple(angles))
    if quaternion is not None:
        return robots.frame(position, _unit("--quaternion", quaternion, 4, "0.92,0,0.38,0"))
    return robots.pose_along(position, _unit("--direction", direction or "0,0,1", 3, "1,0,1"))


def _unit(option: str, text: str, count: int, example: str) -> Float[np.ndarray, "n"]:
    found = vector(option, text, {"": 1.0}, "", count, example)
    if not (length := float(np.linalg.norm(found))):
        raise InputError(f"{option} {text}: its length is 0")
    return found / length


def _bare_text(bare_m: float) -> str:
    if bare_m > 0:
        return f"{1e3 * bare_m:.1f} mm between the TCP and the tool's pieces"
    return "none: the TCP is in a piece of the tool, so that every target collides; delete the wire, or set --stickout"


def _text_mm(position: Float[np.ndarray, "3"]) -> str:
    return f"({', '.join(f'{1e3 * each:.1f}' for each in position + 0.0)}) mm"

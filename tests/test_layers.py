"""Imports run one way: a room imports from itself and from the rooms before it in the list, and never in a circle."""

import ast
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

import htcp_jax

PACKAGE = Path(htcp_jax.__file__).parent

# From the bottom up: what is read makes a scene; small problems in it, and how clear the arm is, make a planner; jobs
# ask it, runs keep the answers, programs give them time, a placement searches among them, validation doubts them, a
# viewer and a report show them, the command is the door.
ROOMS = [
    *("formats", "scene", "solvers", "clearance", "planner", "jobs", "runs", "program", "placement"),
    *("validation", "viewer", "report", "cli"),
]
# Modules for every room.
EVERYWHERE = {"errors", "gpu_kernel", "notebook", "numerics", "pytree", "settings", "status", "types"}
PUBLIC = {"api": "viewer", "__main__": "cli"}  # at the root for its name's sake; stands behind this room


def modules() -> dict[str, Path]:
    """Every module by its dotted name within the package, a room's own by the room's."""
    files = sorted(PACKAGE.rglob("*.py"))
    names = {".".join(file.relative_to(PACKAGE).with_suffix("").parts): file for file in files}
    return {name.removesuffix(".__init__"): file for name, file in names.items()}


def imports(file: Path, known: dict[str, Path]) -> set[str]:
    """Modules of the package that a file imports anywhere in its source."""
    found = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file}: imports are absolute"
            names = [f"{node.module}.{alias.name}" for alias in node.names] + [node.module]
        else:
            continue
        own = [name.removeprefix("htcp_jax.") for name in names if name.startswith("htcp_jax.")]
        found |= {name for name in own if name in known}
    return found


def floor(module: str) -> float:
    """Where a module stands: the number of its room, 0 for what every room may import."""
    room = module.partition(".")[0]
    if room in EVERYWHERE or room == "__init__":
        return 0
    return ROOMS.index(PUBLIC[room]) + 1.5 if room in PUBLIC else ROOMS.index(room) + 1


@pytest.mark.parametrize("module", modules())
def test_imports_run_one_way(module):
    known = modules()
    upwards = sorted(other for other in imports(known[module], known) if floor(other) > floor(module))
    assert not upwards, f"{module} imports from the rooms over it: {', '.join(upwards)}"


def test_every_folder_is_a_room_and_says_what_belongs_in_it():
    folders = {file.parent for file in PACKAGE.rglob("*.py")} - {PACKAGE}
    assert {str(folder.relative_to(PACKAGE)) for folder in folders} == set(ROOMS)
    for folder in folders:
        assert ast.get_docstring(ast.parse((folder / "__init__.py").read_text())), folder


def test_imports_run_in_no_circle():
    known = modules()
    try:
        TopologicalSorter({module: imports(file, known) - {module} for module, file in known.items()}).prepare()
    except CycleError as error:
        pytest.fail(f"imports run in a circle: {' -> '.join(error.args[1])}")

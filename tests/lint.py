"""Style checks that ruff has no rule for: `python tests/lint.py` prints one line per fault and exits with 1 if any.

**Imports.** A package imports from itself and from the packages before it in PACKAGES, at the top of a file or inside a
function; no import cycles. Each folder is one of these packages.

**Validation.** `validation` imports nothing of the planner's mathematics: from other packages only the names in
TO_VALIDATION, which are data, files and constants.

**Files.** `io/files.py` alone opens, reads and writes files: its readers take regular files of a bounded size and
follow no link out of a folder, its writer replaces a file completely or not at all. Other modules make none of the
calls in OPENS, except those that OWN_FILES lists with the reason.

**Docstrings and shapes of public names.** Public is every function and class in `htcp_jax.__all__`, and every one
without an underscore that a page under docs shows: `::: htcp_jax.x.y` shows y or, if y is a module, all of it except
what `members` excludes. A function is complete when

- it has a docstring, and each of its arguments a type;
- the shape of every array is in its annotation, or follows the argument's name in the docstring, "x (N,)";
- its numbers have a unit: a name that ends in one (margin_m), a type that always has one (`types`, a Pose), or one in
  brackets in the docstring, [m], or the docstring names the unit in words; counts and shares need none (COUNTED);
- it mentions "InputError" if it raises one, directly or through a function with an underscore in the same module;
- if it is mathematics, which docs/equations.md and docs/reference/mathematics.md show, it or its module names the
  source: an equation, an algorithm, a section, a book.

A class is complete when it has a docstring, and its fields have shapes and units by annotation, name, type, or in
brackets behind the field or in the docstring.
"""

import ast
import re
import sys
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import NamedTuple

PACKAGE = "htcp_jax"
PACKAGES = [  # from the bottom up
    *("model", "solvers", "clearance", "device", "motion", "planning", "reachability"),
    *("io", "jobs", "runs", "trajectory", "placement", "validation", "viewer", "report", "cli"),
]
ABOVE = {"api": "viewer", "__main__": "cli"}  # modules at the root that import from this package and those before it
TO_VALIDATION = {  # package or module at the root -> names that `validation` imports from it ("*": any) -> reason
    "errors": {"InputError": "how a bad file is refused"},
    "types": {"*": "types of arrays"},
    "status": {"*": "numbers in saved results"},
    "kinds": {"with_arrays": "a job's row of another package, whose own check in numpy is called"},
    "settings": {"Settings": "tolerances of a job"},
    "model": {
        "Tool ZERO TaskRow TaskRowKind": "what a job's file states",
        "PRIMITIVES": "names of MuJoCo's shapes",
        "TOUCHING_M": "overlap of meshes that a job's arm is allowed",
        "Workpiece": "type of what `workpiece_of` loads; its points, path and inlet are copied at once",
    },
    "motion": {"Plans Outcome": "saved results"},
    "trajectory": {"Timed": "saved results"},
    "io": {
        "read_bytes read_json read_yaml read_spec load_geometry Section validate": "readers of files",
        "LinkMeshes": "meshes to which an arm's file refers, placed by MuJoCo and measured by FCL",
    },
    "jobs": {
        "CellConfig PlanConfig RobotConfig WorkpieceConfig": "what a job's file states",
        "arm_of part_of shape_of": "keys of a job, to load each part once",
        "shapes_in_world": "MuJoCo shapes that a job's obstacle of another package states",
        "robot_of workpiece_of": "loading of a workpiece; points on a mesh, which only normals are fitted to, are as "
        "close as the arm needs",
    },
    "runs": {"*": "files of runs"},
}
OPENS = re.compile(  # calls that access a file by its path, by the end of their names
    r"(^|\.)open$|\.(read_text|write_text|read_bytes|write_bytes|touch)$"
    r"|^(np|pq|pa|json|trimesh|pickle)\.(load|loadtxt|genfromtxt|fromfile|save|savez|savez_compressed|savetxt|memmap|dump"
    r"|read_table|read_schema|write_table|ParquetFile|ParquetWriter|OSFile|memory_map)$"
    r"|^tempfile\.|^shutil\.(copy|copyfile|copy2|move)$|\.savefig$"
)
OWN_FILES = {  # modules that open files themselves, and why that is safe
    "io.files": "the one",
    "unfinished": "a lock on each of them",
    "process_exit": "the processes of this one, in /proc",
    "io.parsers": "a process of its own with limits, see formats.scan",
    "io.scan": "reads what that process wrote into a folder that was made just now",
    "jobs.examples": "files that ship with the package",
    "cli.example": "the same, copied into a folder that was made just now",
    "runs.lock": "the lock's file, without following a link",
    "runs.provenance": "/proc/cpuinfo",
    "runs.plan_folder": "files that a person names for the gate, and bytes in memory",
    "device.compile_cache": "the user's own cache",
    "device.processes": "a folder that was made just now",
    "cli.main": "os.devnull",
    "report.document": "a picture in memory",
    "validation.mesh_clearance": "a mesh in memory",
    "cli.robot": "a picture into a folder that was made just now",
    "api": "the same",
}
FUNCTIONS = ast.FunctionDef, ast.AsyncFunctionDef
MATHEMATICS = "equations", "mathematics"  # pages
SHOWN = re.compile(r"^::: htcp_jax\.(\S+)\n((?: +.*\n?)*)", re.MULTILINE)
MEMBERS = re.compile(r"members: \[([^\]]*)\]")
UNIT_IN_NAME = re.compile(r"_(m|mm|rad|deg|s|ms|m2|mm_s|share|rate)$")
UNIT_TOLD = re.compile(r"\[[^\]]*\b(m|mm|rad|deg|s|ms|m2|1|%)\b[^\]]*\]|\b(unit|percent|radians|metres|seconds)\b")
WITH_UNIT = {"Joints", "Pose", "Vector3"}  # of types: [rad or m]; a frame in [m]; a point in [m]
COUNTED = re.compile(r"^(num_.*|.*weights?|tracked|executable|population)$")
SOURCE = re.compile(r"equation|Eq\.|section|Algorithm|paper|constraints\)|Rodrigues|Ericson", re.IGNORECASE)
RANDOM_KEY = "key"  # how names of JAX's random keys end: arrays without a shape
ARRAYS = re.compile(r"\b(np\.ndarray|jax\.Array|Array)\b")
NUMBERS = re.compile(r"\b(Float|float)\b")


def faults(root: Path) -> list[str]:
    """Faults of a checkout, one line each."""
    incomplete_names = (f"{name}: {'; '.join(why)}" for name, why in incomplete(root).items() if why)
    package = root / PACKAGE
    return [*import_faults(package), *validation_faults(package), *file_faults(package), *incomplete_names]


def validation_faults(package: Path) -> Iterator[str]:
    """Imports of `validation` that TO_VALIDATION does not list."""
    for file in sorted((package / "validation").rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            for home, name in _imported_names(node):
                known = {each for names in TO_VALIDATION.get(home, {}) for each in names.split()}
                if home != "validation" and not known & {name, "*"}:
                    here = _dotted(file.relative_to(package))
                    yield f"{here} imports {name} of {home}, which is not in TO_VALIDATION"


def _imported_names(node: ast.AST) -> Iterator[tuple[str, str]]:
    """Names that a statement imports from the package, each with the folder, or the module at the root."""
    if isinstance(node, ast.Import):
        modules = [alias.name.split(".") for alias in node.names]
    elif isinstance(node, ast.ImportFrom):
        modules = [[*str(node.module).split("."), alias.name] for alias in node.names]
    else:
        return
    yield from ((parts[1], parts[-1]) for parts in modules if parts[0] == PACKAGE and len(parts) > 1)


def file_faults(package: Path) -> Iterator[str]:
    """Calls in a package's files that open, read or write a file other than through `io/files.py`."""
    for file in sorted(package.rglob("*.py")):
        name = _dotted(file.relative_to(package))
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))) if name not in OWN_FILES else ():
            if isinstance(node, ast.Call) and OPENS.search(call := ast.unparse(node.func)):
                yield f"{name}, line {node.lineno}: {call}; io/files.py has what is needed"


def import_faults(package: Path) -> Iterator[str]:
    """Upward imports and import cycles in a package, and folders that are missing in PACKAGES."""
    files = {_dotted(file.relative_to(package)): file for file in sorted(package.rglob("*.py"))}
    graph = {name: _imported(file, files.keys()) - {name} for name, file in files.items()}
    for folder in sorted({name.partition(".")[0] for name in files if "." in name} - set(PACKAGES)):
        yield f"{folder}: no package in PACKAGES of {Path(__file__).name}"
    for name, others in graph.items():
        above = sorted(other for other in others if _level(other) > _level(name))
        yield from (f"{name} imports {other}, which lies above it" for other in above)
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        yield f"imports run in a circle: {' > '.join(error.args[1])}"


def _dotted(file: Path) -> str:
    """Dotted name of a module within the package; a folder's own is the folder's name."""
    return ".".join(file.with_suffix("").parts).removesuffix(".__init__")


def _imported(file: Path, known: set[str]) -> set[str]:
    """The `known` modules that a file imports."""
    found = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found |= {f"{node.module}.{alias.name}" for alias in node.names} | {str(node.module)}
    return {name.removeprefix(f"{PACKAGE}.") for name in found if name.startswith(f"{PACKAGE}.")} & known


def _level(module: str) -> float:
    """Position of a module's package; 0 for the other modules at the root, which every package may import."""
    package = module.partition(".")[0]
    if package in ABOVE:
        return PACKAGES.index(ABOVE[package]) + 1.5
    return PACKAGES.index(package) + 1 if package in PACKAGES else 0


class Public(NamedTuple):
    """A public function or class, and its module."""

    node: ast.AST
    module: ast.Module
    lines: list[str]  # of the module
    is_mathematics: bool


def incomplete(root: Path) -> dict[str, list[str]]:
    """Missing documentation of each public name of a checkout; an empty list if it is complete."""
    lost = {name: ["is not where a page or `__all__` says"] for name in _named(root).keys() - public(root).keys()}
    return lost | {name: list(_lacks(one)) for name, one in public(root).items()}


def public(root: Path) -> dict[str, Public]:
    """Public functions and classes of a checkout, by dotted name within the package."""
    found = {}
    for name, is_mathematics in sorted(_named(root).items()):
        module, _, own = name.rpartition(".")
        if (file := _file(root, module)) is not None:
            text = file.read_text(encoding="utf-8")
            tree = ast.parse(text)
            node = next((n for n in tree.body if getattr(n, "name", None) == own), None)
            if node is not None:
                found[name] = Public(node, tree, text.splitlines(), is_mathematics)
    return found


def _named(root: Path) -> dict[str, bool]:
    """Names that `__all__` or a page makes public -> True if documented as mathematics.

    A name in `__all__` that equals its module's name stands for the module as a whole and is excluded.
    """
    named = {f"{home}.{name}": False for name, home in _homes(root).items() if name != home.rpartition(".")[2]}
    for page in sorted((root / "docs").rglob("*.md")):
        for name in _shown(page.read_text(encoding="utf-8"), root):
            named[name] = named.get(name, False) or page.stem in MATHEMATICS
    return named


def _homes(root: Path) -> dict[str, str]:
    """Names in `__all__` -> the module of each."""
    tree = ast.parse((root / PACKAGE / "__init__.py").read_text(encoding="utf-8"))
    for node in tree.body:
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "_HOME":
            return ast.literal_eval(node.value)
    return {}


def _shown(page: str, root: Path) -> Iterator[str]:
    for name, options in SHOWN.findall(page):
        file, members = _file(root, name), MEMBERS.search(options)
        if file is None:
            yield name
        elif members:
            yield from (f"{name}.{member.strip()}" for member in members.group(1).split(",") if member.strip())
        else:
            tree = ast.parse(file.read_text(encoding="utf-8"))
            own = [node.name for node in tree.body if isinstance(node, (*FUNCTIONS, ast.ClassDef))]
            yield from (f"{name}.{each}" for each in own if not each.startswith("_"))


def _file(root: Path, module: str) -> Path | None:
    """File of a module; None if there is no such module."""
    stem = root / PACKAGE / module.replace(".", "/")
    return next((file for file in (stem.with_suffix(".py"), stem / "__init__.py") if file.is_file()), None)


def _lacks(public: Public) -> Iterator[str]:
    node, text = public.node, ast.get_docstring(public.node) or ""
    if not text:
        yield "no docstring"
        return
    if isinstance(node, ast.ClassDef):
        yield from _class_lacks(node, text, public.lines)
        return
    arguments = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
    for one in arguments:
        yield from _value_lacks(one.arg, one.annotation, text)
    if node.returns is not None:
        yield from _value_lacks("return", node.returns, text)
    if _raises(node, public.module, set()) and "InputError" not in text:
        yield "raises InputError and does not say so"
    if public.is_mathematics and not SOURCE.search(text + (ast.get_docstring(public.module) or "")):
        yield "names no source"


def _class_lacks(node: ast.ClassDef, text: str, lines: list[str]) -> Iterator[str]:
    for field in node.body:
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name):
            behind = " ".join(lines[field.lineno - 1 : field.end_lineno]).partition("#")[2]
            yield from _value_lacks(field.target.id, field.annotation, f"{text} {behind}")


def _value_lacks(name: str, annotation: ast.expr | None, text: str) -> Iterator[str]:
    if annotation is None:
        if name not in ("self", "cls"):
            yield f"{name} has no type"
        return
    kind = ast.unparse(annotation)
    bare = re.sub(r"\b(Float|Int|Int8|Bool)\[[^\[\]]*\]", "", kind)
    if ARRAYS.search(bare) and not name.endswith(RANDOM_KEY) and not re.search(rf"\b{name}\b[^.;]*\(\w[^)]*,", text):
        yield f"{name} has no shape"
    has_unit = UNIT_IN_NAME.search(name) or COUNTED.match(name) or any(alias in kind for alias in WITH_UNIT)
    if NUMBERS.search(kind) and not has_unit and not UNIT_TOLD.search(text):
        yield f"{name} has no unit"


def _raises(node: ast.AST, module: ast.Module, seen: set[str]) -> bool:
    """True if a function raises an InputError, directly or through the module's own functions with an underscore."""
    for inner in ast.walk(node):
        if isinstance(inner, ast.Raise) and inner.exc is not None and "InputError" in ast.unparse(inner.exc):
            return True
        if isinstance(inner, ast.Call) and isinstance(inner.func, ast.Name) and inner.func.id.startswith("_"):
            name = inner.func.id
            callee = next((n for n in module.body if isinstance(n, FUNCTIONS) and n.name == name), None)
            if callee is not None and name not in seen and _raises(callee, module, seen | {name}):
                return True
    return False


if __name__ == "__main__":
    found = faults(Path(__file__).resolve().parents[1])
    print(*found, sep="\n", end="\n" if found else "")
    sys.exit(bool(found))

"""Style checks that ruff has no rule for: `python tests/lint.py` prints one line per fault and exits with 1 if any.

**Imports.** A package imports from itself and from the packages before it in PACKAGES, at the top of a file or inside a
function; no import cycles. Each folder is one of these packages.

**Public names.** The stub of a package, `__init__.pyi`, lists its public names: types and functions whose names say
alone what they are, and modules where they do not, as in `tables.gather`. Other packages import these and nothing
deeper; modules of one package import each other. Each name exists, and a package has 5 to 15 of them, except those in
SIZES.

**Validation.** `validation` imports nothing of the planner's mathematics: from other packages only the names in
TO_VALIDATION, which are data, files and constants. A module that it imports counts by the names that it uses of it.

**Libraries.** CORE imports none of those in OUTSIDE_CORE, `spec` none of those in OUTSIDE_SPEC, and `system` none.

**Files.** `system/files.py` alone opens, reads and writes files: its readers take regular files of a bounded size and
follow no link out of a folder, its writer replaces a file completely or not at all. Other modules make none of the
calls in OPENS, except those that OWN_FILES lists with the reason.

**Docstrings and shapes of public names.** Public is every function and class in `htcp_jax/__init__.pyi`, and every one
without an underscore that a page under docs shows: `::: htcp_jax.x.y` shows y or, if y is a module, all of it except
what `members` excludes. A function is complete when

- it has a docstring, and each of its arguments a type;
- the shape of every array is in its annotation, or follows the argument's name in the docstring, "x (N,)";
- its numbers have a unit: a name that ends in one (margin_m), a type that always has one (`types`, a Pose), or one in
  brackets in the docstring, [m], or the docstring names the unit in words; counts and shares need none (COUNTED);
- it mentions "InputError" if it raises one, directly or through a function with an underscore in the same module;
- if it is mathematics, which the pages in MATHEMATICS show, it or its module names the source: an equation, an
  algorithm, a section, a book.

A class is complete when it has a docstring, and its fields have shapes and units by annotation, name, type, or in
brackets behind the field or in the docstring.
"""

import ast
import re
import sys
from collections.abc import Iterator, Sequence
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import NamedTuple

PACKAGE = "htcp_jax"
PACKAGES = [  # from the bottom up
    *("system", "caching", "spec"),
    *("model", "solvers", "clearance", "device", "motion", "planning", "sequencing", "reachability"),
    *("io", "jobs", "runs", "trajectory", "proving", "placement", "validation", "viewer", "report", "cli"),
]
CORE = PACKAGES[3:11]
OUTSIDE_CORE = {"yaml", "pyarrow", "matplotlib", "rich", "mujoco"}  # files, charts, tables, simulation
OUTSIDE_SPEC = {"jax", "mujoco", "scipy", "trimesh", "pyarrow", "matplotlib", "rich"}  # slow to import; not for data
SIZES = {  # packages with fewer than 5 or more than 15 public names, and why
    "": "all that a user needs, and the mathematics for jax.grad",
    "model": "terms that every other package shares",
    "io": "each kind of file has a module or a package",
    "system": "each concern has functions of its own: files, locks, signals, the end of a process",
    "spec": "each thing that people write has a type, and its keys have choices",
    "clearance.obstacles": "each kind of obstacle has a type and a function that makes it",
    "jobs": "a job, a sweep, seams and a batch have builders of their own",
    "trajectory": "programs, their figures and the timing of plans and runs",
    "proving": "curves of a motion, and proofs of arrays, of files and of our programs",
    "sequencing": "an order, its result, and the check of its precedence",
    "report": "pages of runs and of plans, and the facts and tables that commands share with them",
    "viewer": "pictures, movies and replays of plans, of runs and of programs",
    "motion": "plans, their checks and the functions of one lane, which two families of methods are made of",
    "runs": "each file of a run's folder has a module",
    "io.robots": "each step from a vendor's file, or the files of a cell, to an arm has a module",
    "cli": "the command alone",
}
# Modules at the root that import from this package and those before it.
ABOVE = {"__init__": "caching", "api": "viewer", "__main__": "cli"}
TO_VALIDATION = {  # package or module at the root -> names that `validation` imports from it ("*": any) -> reason
    "errors": {"InputError": "how a bad file is refused"},
    "types": {"*": "types of arrays"},
    "status": {"*": "numbers in saved results"},
    "settings": {"Settings": "tolerances of a job"},
    "system": {
        "write_json write_text": "how results are written",
        "read_json": "reader of a run's files",
    },
    "spec": {
        "CellConfig CloudConfig FixtureConfig PlanConfig RobotConfig WorkpieceConfig WORLD Tool ZERO": "what a job's "
        "file states",
        "ModelSource label_of default_tcp": "reader of an arm's file, or of a cell's, which MuJoCo composes",
        "FileSection read_yaml validate_model is_limits_file feed_of": "readers of files and of their values",
        "TaskRowKind BuiltInRow PointRow AxisRow OrientationRow ToolAxisRow TCP_ON_PATH "
        "path_row": "rows of a job's task",
        "with_arrays": "a job's row of another package, whose own check in numpy is called",
    },
    "model": {
        "PRIMITIVES": "names of MuJoCo's shapes",
        "TOUCHING_M": "overlap of meshes that a job's arm is allowed",
        "Workpiece": "type of what `workpiece_of` loads; its points, triangles, path and inlet are copied at once",
    },
    "motion": {"Plans Outcome": "saved results"},
    "trajectory": {"TimedMotion": "saved results"},
    "io": {
        "load_geometry": "reader of a part's file",
        "read_meshes thickness_m THIN_M": "reader of a cell's file: the triangles that the planner reads, and which of "
        "them are a solid or flat",
        "read_model": "reader of an arm's file, or of a cell's, which MuJoCo composes",
        "read_joint_limits": "reader of a file with joint limits",
        "indexed_joints": "names of the indexed axes, of the job and of its models",
        "LinkMeshes": "meshes to which an arm's file refers, placed by MuJoCo and measured by FCL",
    },
    "jobs": {
        "robot_key workpiece_key walls_key": "keys of a job, to load each part once",
        "shapes_in_world": "MuJoCo shapes that a job's obstacle of another package states",
        "robot_of workpiece_of": "loading of a workpiece; points on a mesh, which only normals are fitted to, are as "
        "close as the arm needs",
    },
    "runs": {"*": "files of runs"},
}
OPENS = re.compile(  # calls that access a file by its path, by the end of their names
    r"(^|\.)open$|(?<!^output_files)\.(read_text|write_text|read_bytes|write_bytes|touch)$"
    r"|^(np|pq|pa|json|trimesh|pickle)\.(load|loadtxt|genfromtxt|fromfile|save|savez|savez_compressed|savetxt|memmap|dump"
    r"|read_table|read_schema|write_table|ParquetFile|ParquetWriter|OSFile|memory_map)$"
    r"|^tempfile\.|^shutil\.(copy|copyfile|copy2|move)$|\.savefig$"
)
OWN_FILES = {  # modules that open files themselves, and why that is safe
    "system.files": "the one",
    "io.arrays": "streams that `system.files` opened",
    "system.unfinished": "a lock on each of them",
    "system.process_exit": "the processes of this one, in /proc",
    "io.parts.parsers": "a process of its own with limits, see io.parts.scan",
    "io.parts.scan": "reads what that process wrote into a folder that was made just now",
    "spec.examples": "files that ship with the package",
    "cli.example": "the same, copied into a folder that was made just now",
    "system.lock": "the lock's file, without following a link",
    "runs.provenance": "/proc/cpuinfo",
    "system.output_files": "files that a person names for the gate",
    "runs.plan_folder": "bytes in memory",
    "runs.checkpoint": "bytes in memory",
    "caching.cache_folder": "the user's own cache",
    "caching.cache_key": "the source of this package, and /proc/cpuinfo",
    "device.processes": "a folder that was made just now",
    "cli.main": "os.devnull",
    "report.document": "a picture in memory",
    "cli.robot": "a picture into a folder that was made just now",
    "cli.tool": "the same",
    "api": "the same",
}
FUNCTIONS = ast.FunctionDef, ast.AsyncFunctionDef
MATHEMATICS = "bounds", "equations", "mathematics"  # pages
SHOWN = re.compile(r"^::: htcp_jax\.(\S+)\n((?: +.*\n?)*)", re.MULTILINE)
MEMBERS = re.compile(r"members: \[([^\]]*)\]")
UNIT_IN_NAME = re.compile(r"_(m|mm|rad|deg|s|ms|m2|mm_s|share|rate)$")
UNIT_IN_TEXT = re.compile(r"\[[^\]]*\b(m|mm|rad|deg|s|ms|m2|1|%)\b[^\]]*\]|\b(unit|percent|radians|metres|seconds)\b")
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
    imports = *import_faults(package), *public_faults(package), *validation_faults(package), *library_faults(package)
    return [*imports, *file_faults(package), *incomplete_names]


def public_faults(package: Path) -> Iterator[str]:
    """Imports across packages that bypass the public names, public names that do not exist, and packages with too many
    or too few of them."""
    for file in sorted(package.rglob("__init__.pyi")):
        unit = ".".join(file.parent.relative_to(package).parts)
        for name, target in public_names(package, unit).items():
            if not _exists(package, target, unit):
                yield f"{unit or PACKAGE}: {target} does not exist, but {name} is public"
        count = len(public_names(package, unit))
        if not 5 <= count <= 15 and unit not in SIZES:
            yield f"{unit}: {count} public names; 5 to 15 are allowed, or a reason in SIZES"
    for file in sorted(package.rglob("*.py")):
        name = _dotted(file.relative_to(package))
        if file.stem == "__init__" and name in PACKAGES and not file.with_suffix(".pyi").is_file():
            yield f"{name}: no __init__.pyi with its public names"
        for node in nodes_in(file):
            for home, imported in imports_in(node):
                other = home.partition(".")[0]
                foreign = other in PACKAGES and other != name.partition(".")[0]
                if foreign and (package / other / "__init__.pyi").is_file():
                    if imported not in public_names(package, home):
                        yield f"{name} imports {imported or 'all'} of {home}, which is not public there"


def library_faults(package: Path) -> Iterator[str]:
    """Imports of libraries that a package must not use."""
    for folder in ("system", "spec", *CORE):
        for file in sorted((package / folder).rglob("*.py")):
            for node in nodes_in(file):
                modules = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
                modules += [str(node.module)] if isinstance(node, ast.ImportFrom) else []
                for library in sorted({module.partition(".")[0] for module in modules}):
                    if _is_outside(folder, library):
                        yield f"{_dotted(file.relative_to(package))} imports {library}, which is not for {folder}"


def _is_outside(folder: str, library: str) -> bool:
    if folder == "system":
        return library not in {*sys.stdlib_module_names, PACKAGE, "lazy_loader"}
    return library in (OUTSIDE_SPEC if folder == "spec" else OUTSIDE_CORE)


def validation_faults(package: Path) -> Iterator[str]:
    """Imports of `validation` that TO_VALIDATION does not list."""
    for file in sorted((package / "validation").rglob("*.py")):
        for home, name in sorted(set(_used(nodes_in(file), package))):
            known = {each for names in TO_VALIDATION.get(home, {}) for each in names.split()}
            if home != "validation" and not known & {name, "*"}:
                here = _dotted(file.relative_to(package))
                yield f"{here} imports {name} of {home}, which is not in TO_VALIDATION"


def _used(nodes: Sequence[ast.AST], package: Path) -> Iterator[tuple[str, str]]:
    """Names that a module imports from other packages, each with the folder, or the module at the root. A public module
    counts by the names that are used of it; by its own name if it is used in any other way."""
    names = [node for node in nodes if isinstance(node, ast.Name)]
    attributes = [node for node in nodes if isinstance(node, ast.Attribute)]
    for node in nodes:
        local = {
            alias.name: alias.asname or alias.name for alias in getattr(node, "names", []) if hasattr(alias, "name")
        }
        for module, name in imports_in(node):
            home = (module or name).partition(".")[0]
            if _file(package.parent, public_names(package, module).get(name, "no such module")) is None:
                yield home, name or module.rpartition(".")[2]
                continue
            of_it = [one for one in attributes if isinstance(one.value, ast.Name) and one.value.id == local[name]]
            yield from ((home, one.attr) for one in of_it)
            if not of_it or len(of_it) < sum(one.id == local[name] for one in names):
                yield home, name


def nodes_in(file: Path) -> Sequence[ast.AST]:
    """All nodes of a file's source, see `nodes_of`."""
    return nodes_of(file.read_text(encoding="utf-8"))


@cache
def nodes_of(text: str) -> Sequence[ast.AST]:
    """All nodes of a source text; the first is the module."""
    return tuple(ast.walk(ast.parse(text)))


def imports_in(node: ast.AST) -> Iterator[tuple[str, str]]:
    """Names that a statement or a call of `import_module` imports from the package, each with the dotted module within
    it. "" is the package itself, or the name of a module that is imported as a module."""
    if isinstance(node, ast.Import):
        modules = [(alias.name, "") for alias in node.names]
    elif isinstance(node, ast.ImportFrom):
        modules = [(str(node.module), alias.name) for alias in node.names]
    elif isinstance(node, ast.Call) and _called(node).endswith("import_module"):
        called = [one.value for one in node.args if isinstance(one, ast.Constant) and isinstance(one.value, str)]
        modules = [module.rpartition(".")[::2] for module in called]
    else:
        return
    for module, name in modules:
        if module.partition(".")[0] == PACKAGE and (name or module != PACKAGE):
            yield module.removeprefix(PACKAGE).removeprefix("."), name


def _called(call: ast.Call) -> str:
    """Last name of what is called, for example "import_module" of "importlib.import_module"; "" if it has none."""
    return getattr(call.func, "attr", getattr(call.func, "id", ""))


def public_names(package: Path, unit: str) -> dict[str, str]:
    """Public names of a package, each with its dotted name within the package: of the module, or module and name."""
    stub = package / unit.replace(".", "/") / "__init__.pyi"
    return _listed(stub.read_text(encoding="utf-8"), unit) if stub.is_file() else {}


@cache
def _listed(stub: str, unit: str) -> dict[str, str]:
    imports = [node for node in ast.parse(stub).body if isinstance(node, ast.ImportFrom)]
    return {
        alias.name: ".".join(part for part in (unit, node.module, alias.name) if part)
        for node in imports
        for alias in node.names
    }


def _exists(package: Path, target: str, unit: str) -> bool:
    """True if there is a module of a dotted name, a module that binds the name, or another unit that lists it."""
    module, _, name = target.rpartition(".")
    if _file(package.parent, target) is not None or (module != unit and name in public_names(package, module)):
        return True
    file = _file(package.parent, module)
    body = nodes_in(file)[0].body if file else []
    bound = {getattr(node, "name", "") for node in body}
    targets = [one for node in body for one in getattr(node, "targets", [getattr(node, "target", None)]) if one]
    return name in bound | {one.id for each in targets for one in ast.walk(each) if isinstance(one, ast.Name)}


def file_faults(package: Path) -> Iterator[str]:
    """Calls in a package's files that open, read or write a file other than through `system/files.py`."""
    for file in sorted(package.rglob("*.py")):
        name = _dotted(file.relative_to(package))
        for node in nodes_in(file) if name not in OWN_FILES else ():
            if isinstance(node, ast.Call) and OPENS.search(call := ast.unparse(node.func)):
                yield f"{name}, line {node.lineno}: {call}; system/files.py has what is needed"


def import_faults(package: Path) -> Iterator[str]:
    """Upward imports and import cycles in a package, and folders that are missing in PACKAGES."""
    files = {_dotted(file.relative_to(package)): file for file in sorted(package.rglob("*.py"))}
    graph = {name: _imported(file, package, files.keys()) - {name} for name, file in files.items()}
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


def _imported(file: Path, package: Path, known: set[str]) -> set[str]:
    """The `known` modules that a file imports; a public name counts as its module."""
    found = set()
    for node in nodes_in(file):
        for module, name in imports_in(node):
            target = public_names(package, module).get(name, "") if module else ""
            found |= {module, f"{module}.{name}".strip("."), target, target.rpartition(".")[0]}
    return found & known


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
    lost = {name: ["is not where a page or a stub refers to"] for name in _named(root).keys() - public(root).keys()}
    return lost | {name: list(_lacks(one)) for name, one in public(root).items()}


def public(root: Path) -> dict[str, Public]:
    """Public functions and classes of a checkout, by dotted name within the package."""
    found = {}
    for name, is_mathematics in sorted(_named(root).items()):
        module, _, own = name.rpartition(".")
        if (file := _file(root, module)) is not None:
            tree = nodes_in(file)[0]
            node = next((n for n in tree.body if getattr(n, "name", None) == own), None)
            if node is not None:
                found[name] = Public(node, tree, file.read_text(encoding="utf-8").splitlines(), is_mathematics)
    return found


def _named(root: Path) -> dict[str, bool]:
    """Names that the stub of the package or a page makes public -> True if documented as mathematics.

    Modules and packages in the stub are excluded: pages show what is public of them.
    """
    named = {each: False for each in public_names(root / PACKAGE, "").values() if _file(root, each) is None}
    for page in sorted((root / "docs").rglob("*.md")):
        for name in _shown(page.read_text(encoding="utf-8"), root):
            named[name] = named.get(name, False) or page.stem in MATHEMATICS
    return named


def _shown(page: str, root: Path) -> Iterator[str]:
    for name, options in SHOWN.findall(page):
        file, members = _file(root, name), MEMBERS.search(options)
        if file is None:
            yield name
        elif members:
            yield from (f"{name}.{member.strip()}" for member in members.group(1).split(",") if member.strip())
        else:
            own = [node.name for node in nodes_in(file)[0].body if isinstance(node, (*FUNCTIONS, ast.ClassDef))]
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
        yield "raises InputError without mentioning it"
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
    if NUMBERS.search(kind) and not has_unit and not UNIT_IN_TEXT.search(text):
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

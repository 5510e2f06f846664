"""The quick tests that a change can break: `python tests/changed.py [COMMIT]` prints their files.

What has changed is everything that differs from the commit (default: the last one), files that git does not track
included. A test file is printed if its imports reach a changed file, through other modules and test helpers. A public
name counts as its module, also in `htcp_jax.name`, and so does a module's name in a string.

A test that starts `htcp` imports the commands whose names occur in it; all of the package if it also reads the
documentation, configs, sweeps or notebooks. All tests are printed if a file has changed about which nothing is known:
settings of the tests, the Makefile, data.
"""

import ast
import re
import subprocess
import sys
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

from lint import PACKAGE, imports_in, nodes_in, nodes_of, public_names

ROOT = Path(__file__).resolve().parents[1]
READ = "docs", "configs", "sweeps", "notebooks", "README.md", "CONTRIBUTING.md"  # what tests read as text
UNTESTED = "benchmarks", "findings", ".github", ".ci", "CHANGELOG.md", "LICENSE", "CITATION.cff", ".gitignore"
STARTS_HTCP = re.compile(r"htcp_jax\.cli|subprocess")


def files_to_test(root: Path, changed: Iterable[str]) -> list[str]:
    """Return the test files that a change of these files can break.

    Args:
        root: Folder of the checkout.
        changed: Changed files, relative to it.
    """
    tests = sorted(file.relative_to(root).as_posix() for file in (root / "tests").glob("test_*.py"))
    known = {name for name in map(_as_node, changed) if name is not None}
    if "" in known:
        return tests
    graph = dict(graph_of(root))
    return [test for test in tests if known & reached(test, graph)]


def _as_node(file: str) -> str | None:
    """Return a file's name in the graph; "" if every test can depend on it, None if no test does."""
    path = Path(file)
    if path.parts[0] in READ:
        return "READ"
    if path.parts[0] in UNTESTED or file.startswith("tests/text/"):
        return None
    if path.parts[0] == PACKAGE and path.suffix in (".py", ".pyi"):
        return _module(path)
    return file if re.fullmatch(r"tests/(?!conftest)\w+\.py", file) else ""


def _module(path: Path) -> str:
    """Return the dotted name of a file of the package; a package's stub counts as the package."""
    return ".".join(path.with_suffix("").parts).removesuffix(".__init__")


def graph_of(root: Path) -> Iterator[tuple[str, set[str]]]:
    """Yield each file with what it imports: modules of the package, and test helpers."""
    package, tests = root / PACKAGE, root / "tests"
    modules = {_module(file.relative_to(root)): file for file in package.rglob("*.py")}
    helpers = {file.stem: file.relative_to(root).as_posix() for file in tests.glob("*.py")}
    for name, file in modules.items():
        yield name, {name.rpartition(".")[0], *_package_imports(file, package, modules.keys())} - {name, ""}
    fixtures = _fixtures(tests / "conftest.py") if (tests / "conftest.py").is_file() else {}
    for stem, name in helpers.items():
        text = (tests / f"{stem}.py").read_text(encoding="utf-8")
        named = _names(text).union(*(used for fixture, used in fixtures.items() if _takes(text, fixture)))
        yield (
            name,
            {helpers[each] for each in named & helpers.keys()} | _used(text, tests / f"{stem}.py", modules, package),
        )


def _used(text: str, file: Path, modules: Iterable[str], package: Path) -> set[str]:
    """Return the modules of the package that a file of the tests can load, and READ if it reads documentation."""
    used = _package_imports(file, package, modules)
    for name in re.findall(rf"{PACKAGE}\.(\w+)", text):
        used |= {f"{PACKAGE}.{each}".rstrip(".") for each in _loaded(package, "", name)} & set(modules)
    reads = any(each in text for each in READ)
    if STARTS_HTCP.search(text):
        commands = {name for name in modules if re.fullmatch(rf"{PACKAGE}\.cli\.\w+", name)}
        used |= {
            f"{PACKAGE}.__main__",
            *(name for name in commands if re.search(rf"\b{name.rpartition('.')[2]}\b", text)),
        }
        used |= set(modules) if reads else set()
    return used | ({"READ"} if reads else set())


def _takes(text: str, fixture: str) -> bool:
    """Return True if a function of a file has an argument with this name."""
    return re.search(rf"^ *def \w+\([^)]*\b{fixture}\b", text, re.MULTILINE) is not None


def _package_imports(file: Path, package: Path, modules: Iterable[str]) -> set[str]:
    """Return the modules of the package that a file imports, or whose name is a string in it."""
    nodes = nodes_in(file)
    found = {node.value for node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, str)}
    for node in nodes:
        for module, name in imports_in(node):
            found |= {f"{PACKAGE}.{each}".rstrip(".") for each in _loaded(package, module, name)}
    return found & set(modules)


@cache
def _loaded(package: Path, module: str, name: str) -> frozenset[str]:
    """Return the modules that an import of a name loads; those of all public names if it is a package."""
    whole = f"{module}.{name}".strip(".")
    target = public_names(package, module).get(name, whole)
    targets = public_names(package, whole).values() if target == whole else [target]
    inner = [_loaded(package, *target.rpartition(".")[::2]) for target in targets]
    return frozenset({module, whole}).union(*inner)


def _names(text: str) -> set[str]:
    """Return the modules that a file imports, without the package's."""
    found = set()
    for node in nodes_of(text):
        if isinstance(node, ast.Import):
            found |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found.add(str(node.module).partition(".")[0])
    return found


def _fixtures(file: Path) -> dict[str, set[str]]:
    """Return the functions of conftest.py, each with the modules that it imports when it is called."""
    body = ast.parse(file.read_text(encoding="utf-8")).body
    return {node.name: _names(ast.unparse(node)) for node in body if isinstance(node, ast.FunctionDef)}


def reached(start: str, graph: dict[str, set[str]]) -> set[str]:
    """Return all that a file imports, directly or through others, and itself."""
    found, open_ = set(), [start]
    while open_:
        name = open_.pop()
        if name not in found:
            found.add(name)
            open_ += graph.get(name, ())
    return found


def changed_since(commit: str) -> list[str]:
    """Return the files that differ from a commit, files that git does not track included."""
    calls = ["diff", "--name-only", "--no-renames", commit, "--"], ["ls-files", "--others", "--exclude-standard"]
    texts = [
        subprocess.run(["git", *call], cwd=ROOT, check=True, capture_output=True, text=True).stdout for call in calls
    ]
    return "".join(texts).splitlines()


if __name__ == "__main__":
    try:
        changed = changed_since(sys.argv[1] if len(sys.argv) > 1 else "HEAD")
    except subprocess.CalledProcessError as error:
        sys.exit(f"changed.py: {error.stderr.strip().splitlines()[0]}")
    print(*files_to_test(ROOT, changed), sep="\n")

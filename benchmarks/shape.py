"""Metrics of the source: sizes, depth of imports, comments and docstrings, of this checkout and of others.

    python -m benchmarks shape [CHECKOUT...]     a checkout, or a folder with the package htcp_jax in it

Every number comes from the syntax tree and the tokens of the package's *.py files; nothing is imported or run.

- Lines: all of them. Median, 90th percentile and maximum are over the files, except each `__init__` with at most a
  docstring.
- A function is every `def`, including methods and nested functions, from that line to its last, without decorators. Its
  body excludes the lines of its docstring. A class is counted like a function, with its docstring and methods.
- Comments and docstrings: lines with a comment, and lines of the docstrings of modules, classes and functions, per 100
  non-blank lines.
- Return types: the share of functions with an annotated return type.
- Imports are those of modules of this package at module level, also under `if` or `try`, but not inside functions, and
  not of an `__init__` that is excluded above. Depth: the number of modules in the longest chain of imports.
- Arrows lead from a folder to each other folder from which any of its modules imports; modules at the root are
  excluded. An arrow runs back if it is part of a cycle of folders. A cycle of modules: all that import each other.
"""

import ast
import io
import statistics
import sys
import tokenize
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import NamedTuple

PACKAGE = "htcp_jax"
ROOT = Path(__file__).resolve().parents[1]
DEFINITIONS = ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef
FUNCTIONS = ast.FunctionDef, ast.AsyncFunctionDef
BLOCKS = ast.If, ast.Try, ast.With


class Spread(NamedTuple):
    """Distribution of a list of sizes."""

    median: float
    p90: float
    largest: float

    def __str__(self) -> str:
        return "/".join(f"{value:.0f}" for value in self)


def spread(sizes: list[int]) -> Spread:
    """Median, 90th percentile (interpolated) and maximum of at least two sizes."""
    return Spread(statistics.median(sizes), statistics.quantiles(sizes, n=10, method="inclusive")[-1], max(sizes))


@dataclass(frozen=True)
class Source:
    """Source file."""

    name: str  # dotted, within the package
    text: str
    tree: ast.Module = field(repr=False)

    def all(self, kinds: tuple[type, ...]) -> list:
        """Nodes of some kinds."""
        return [node for node in ast.walk(self.tree) if isinstance(node, kinds)]

    @property
    def lines(self) -> int:
        """Number of lines."""
        return len(self.text.splitlines())

    @property
    def filled(self) -> int:
        """Number of non-blank lines."""
        return sum(bool(line.strip()) for line in self.text.splitlines())

    @property
    def comments(self) -> int:
        """Number of lines with a comment."""
        tokens = tokenize.generate_tokens(io.StringIO(self.text).readline)
        return len({token.start[0] for token in tokens if token.type == tokenize.COMMENT})

    @property
    def docstrings(self) -> int:
        """Number of lines of docstrings."""
        return sum(length(text) for node in self.all(DEFINITIONS) if (text := docstring(node)) is not None)

    @property
    def is_bare(self) -> bool:
        """True for the `__init__` of a folder with at most a docstring."""
        return self.name.endswith("__init__") and len(self.tree.body) < 2


@dataclass(frozen=True)
class Tree:
    """Package of one checkout."""

    name: str
    root: Path

    @cached_property
    def sources(self) -> dict[str, Source]:
        """Files by the dotted names of their modules; an `__init__` by the name of its folder."""
        package = self.root / PACKAGE
        found = {}
        for file in sorted(package.rglob("*.py")):
            text = file.read_text(encoding="utf-8")
            name = ".".join(file.relative_to(package).with_suffix("").parts)
            found[name.removesuffix(".__init__")] = Source(name, text, ast.parse(text))
        return found

    @cached_property
    def imports(self) -> dict[str, set[str]]:
        """Modules that each module imports at its top level."""
        bare = {name for name, source in self.sources.items() if source.is_bare}
        known = self.sources.keys() - bare
        return {name: (imported(source.tree, known) - {name}) for name, source in self.sources.items()}

    @cached_property
    def chain(self) -> list[str]:
        """Longest chain of imports, each module importing the next; empty if there is a cycle."""
        if self.circles:
            return []
        longest: dict[str, list[str]] = {}
        for name in TopologicalSorter(self.imports).static_order():
            below = [longest[other] for other in sorted(self.imports[name])]
            longest[name] = [name, *max(below, key=len, default=[])]
        return max(longest.values(), key=len)

    @cached_property
    def circles(self) -> list[str]:
        """Modules of a cycle of imports, if there is one."""
        return circle(self.imports)

    @cached_property
    def arrows(self) -> set[tuple[str, str]]:
        """Pairs of folders; the first imports from the second."""
        pairs = {(folder(a), folder(b)) for a, below in self.imports.items() for b in below}
        return {(a, b) for a, b in pairs if a and b and a != b}

    @property
    def arrows_back(self) -> int:
        """Number of arrows that are part of a cycle of folders."""
        return sum(a in reached(b, self.arrows) for a, b in self.arrows)

    @property
    def files(self) -> list[int]:
        """Numbers of lines of the files."""
        return [source.lines for source in self.sources.values() if not source.is_bare]

    @cached_property
    def functions(self) -> list:
        """Every function of the package."""
        return [node for source in self.sources.values() for node in source.all(FUNCTIONS)]

    @property
    def bodies(self) -> list[int]:
        """Numbers of lines of the functions without their docstrings."""
        return [length(node) - (0 if docstring(node) is None else length(docstring(node))) for node in self.functions]

    @property
    def classes(self) -> dict[str, int]:
        """Numbers of lines of the classes by their names."""
        nodes = {(name, node) for name, source in self.sources.items() for node in source.all((ast.ClassDef,))}
        return {f"{name}.{node.name}": length(node) for name, node in nodes}

    def share(self, count: Callable[[Source], int]) -> float:
        """Lines of a kind per 100 non-blank lines."""
        sources = self.sources.values()
        return 100 * sum(map(count, sources)) / sum(source.filled for source in sources)


def length(node: ast.AST) -> int:
    """Number of lines of a node, without its decorators."""
    return node.end_lineno - node.lineno + 1


def docstring(node: ast.AST) -> ast.Expr | None:
    """Docstring of a module, a class or a function, as a statement; None without one."""
    first = node.body[0] if node.body else None
    is_text = isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant)
    return first if is_text and isinstance(first.value.value, str) else None


def imported(tree: ast.Module, known: set[str]) -> set[str]:
    """The `known` modules that a module imports at its top level."""
    found: set[str] = set()
    for node in _statements(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found |= {f"{node.module}.{alias.name}" for alias in node.names} | {str(node.module)}
    return {name.removeprefix(f"{PACKAGE}.") for name in found if name.startswith(f"{PACKAGE}.")} & known


def _statements(block: ast.AST) -> Iterator[ast.stmt]:
    """Statements that run when a module is imported, which excludes `if TYPE_CHECKING`."""
    for node in getattr(block, "body", []):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        yield node
        if isinstance(node, BLOCKS):
            yield from _statements(node)


def folder(module: str) -> str:
    """Folder of a module; empty at the root."""
    return module.partition(".")[0] if "." in module else ""


def reached(start: str, arrows: set[tuple[str, str]]) -> set[str]:
    """Folders to which arrows lead from `start`."""
    found, left = set(), [start]
    while left:
        here = left.pop()
        new = {b for a, b in arrows if a == here} - found
        found |= new
        left += new
    return found


def circle(graph: dict[str, set[str]]) -> list[str]:
    """Names along a cycle in a graph; empty if there is none."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


def rows(tree: Tree) -> dict[str, str]:
    """Column of the table for one checkout."""
    sources, functions = tree.sources.values(), tree.functions
    largest, size = max(tree.classes.items(), key=lambda item: item[1])
    return {
        "files": f"{len(sources)}",
        "lines": f"{sum(source.lines for source in sources):,}",
        "a file: median/p90/max": str(spread(tree.files)),
        "a function: median/p90/max": str(spread([length(node) for node in functions])),
        "a body: median/p90/max": str(spread(tree.bodies)),
        "the largest class": f"{size} {largest.rpartition('.')[2]}",
        "comments of 100 lines": f"{tree.share(lambda source: source.comments):.1f}",
        "docstrings of 100 lines": f"{tree.share(lambda source: source.docstrings):.1f}",
        "return types": f"{100 * sum(node.returns is not None for node in functions) / len(functions):.0f} %",
        "depth of imports": str(len(tree.chain)) if not tree.circles else "endless",
        "folders' arrows": f"{len(tree.arrows)}",
        "of them back": f"{tree.arrows_back}",
        "circles of modules": "none" if not tree.circles else " > ".join(tree.circles),
    }


def main() -> None:
    """Print one column per checkout, then the longest chain of imports in the last one."""
    given = [Path(word) for word in sys.argv[1:]] or [ROOT]
    trees = [Tree(path.resolve().name, path.resolve()) for path in given]
    columns = [rows(tree) for tree in trees]
    widths = [max(len(tree.name), *map(len, column.values())) for tree, column in zip(trees, columns, strict=True)]
    first = max(map(len, columns[0]))
    print(" " * first, *(tree.name.rjust(width) for tree, width in zip(trees, widths, strict=True)), sep="  ")
    for name in columns[0]:
        cells = (column[name].rjust(width) for column, width in zip(columns, widths, strict=True))
        print(name.ljust(first), *cells, sep="  ")
    print("\nthe longest chain:", " > ".join(trees[-1].chain))

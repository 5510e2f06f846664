"""Mutation testing: 60 small faults in the mathematics and the planners, and the tests that notice them.

    python -m benchmarks mutants [--only N,...] [--jobs 1] [--cache DIR] [--record] [-- PYTEST ARGUMENT...]
    python -m benchmarks mutants --draw SEED     (pip install cosmic-ray==8.7.0)

mutants.yaml lists the mutants: a number, the file, the operator, the source lines before and after, the test files, and
whether these noticed the mutant. The original lines are found by their text, in the file or, if they have moved, in
another file of the package. The exit code is 1 if a mutant is not noticed that mutants.yaml lists as noticed. With
--record the results are written to mutants.yaml instead.

Each mutant gets a temporary copy of the tree, in which `pytest -x` runs its test files at low priority. A failed test,
a crash and a run over LIMIT_S count as noticed. The unmutated test files run first, with the compiled programs in
--cache or with none. They must pass, and the files of one mutant together must take at most half of LIMIT_S. Every
mutant then starts with a copy of the compiled programs.

--draw replaces the list. The sites are all those of cosmic-ray's operators in MODULES, drawn without replacement by
`random.Random(SEED)`; one of the site's mutations is then drawn. Excluded: annotations, decorators, imports, `raise`,
f-strings, decorator removal (jax.jit changes no result), and operators of another family: arithmetic is replaced by
arithmetic, bits by bits, a comparison by a comparison. The test files are those that import the mutant's module or, if
there are none, those that import the nearest modules which import it: first the one named for the module, then by how
often they use what they import from it, the most often first, at most TEST_FILES. Files with slow tests only are
excluded: pytest's configuration deselects them.
"""

import argparse
import ast
import contextlib
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import NamedTuple

import yaml

ROOT = Path(__file__).resolve().parents[1]
LIST = Path(__file__).with_name("mutants.yaml")
LIMIT_S = 240  # CPU time of pytest's process, so that other work on the machine does not change results
HANG_S = 900  # wall time, to end a process that waits without end
TEST_FILES = 3
MODEL = "goals inverse_kinematics kinematics path_frames robot surface task task_rows workpiece".split()
MODULES = [f"model/{name}.py" for name in MODEL] + ["io/robots/capsule_fit.py", "numerics.py"]
MODULES += [f"{package}/**/*.py" for package in "solvers clearance device motion planning reachability".split()]
NO_MATHEMATICS = "cache_folder.py", "devices.py", "processes.py", "registry.py", "__init__.py"
NOT_COPIED = shutil.ignore_patterns(".git", ".venv", "build", "dist", "out", "site", "__pycache__", ".*_cache")
FAMILIES = "Add Sub Mul Div FloorDiv Mod Pow", "RShift LShift BitOr BitAnd BitXor", "Eq NotEq Lt LtE Gt GtE", "Is IsNot"


class Run(NamedTuple):
    """Result of running test files: pytest's exit code (negative: a signal), CPU time [s], and the failure's line."""

    code: int
    cpu_s: float
    failure: str


def mutated(root: Path, mutant: dict) -> tuple[Path, str]:
    """Return the file under `root` that contains the mutant's lines exactly once, and its mutated text."""
    before, after = f"\n{mutant['before']}\n", f"\n{mutant['after']}\n"
    for file in [root / mutant["file"], *sorted((root / "htcp_jax").rglob("*.py"))]:
        text = "\n" + (file.read_text(encoding="utf-8") if file.is_file() else "")
        if text.count(before) == 1:
            return file, text.replace(before, after)[1:]
    raise SystemExit(f"mutant {mutant['number']}: its lines are in no file of htcp_jax, or more than once")


def run_tests(tests: list[str], cache: Path, extra: list[str], mutant: dict | None = None) -> Run:
    """Run test files with pytest in a temporary copy of the tree, which is mutated if `mutant` is not None."""
    with tempfile.TemporaryDirectory() as folder:
        root = shutil.copytree(ROOT, Path(folder, "tree"), ignore=NOT_COPIED)
        if mutant is not None:
            file, text = mutated(root, mutant)
            file.write_text(text, encoding="utf-8")
            cache = shutil.copytree(cache, Path(folder, "cache"), copy_function=os.link)
        pytest = [sys.executable, "-m", "pytest", "-x", f"--basetemp={folder}/tmp", *extra, *tests]
        command = ["sh", "-c", f'ulimit -t {LIMIT_S}; exec nice -n 19 "$@"', "sh", *pytest]
        env = os.environ | {"PYTHONPATH": str(root), "HTCP_CACHE": str(cache)}
        with open(f"{folder}/log", "w+", encoding="utf-8") as log:
            process = subprocess.Popen(command, cwd=root, env=env, stdout=log, stderr=log, start_new_session=True)
            hang = threading.Timer(HANG_S, os.killpg, (process.pid, signal.SIGKILL))
            hang.start()
            _, status, used = os.wait4(process.pid, 0)
            hang.cancel()
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)  # ends workers that a crash left behind
            log.seek(0)
            failures = [line.strip() for line in log if line.startswith(("FAILED", "ERROR"))]
        code = os.waitstatus_to_exitcode(status)
        return Run(code, used.ru_utime + used.ru_stime, failures[-1] if failures else f"exit code {code}")


def check(mutants: list[dict], jobs: int, start: Path | None, extra: list[str]) -> list[bool]:
    """Return True for each mutant that its test files notice; print each result as soon as it is known.

    `start` is a folder with compiled programs to start with; None: start without any.
    """
    for mutant in mutants:
        mutated(ROOT, mutant)  # raises here, before tests run, if the lines are not found
    files, alone_s = sorted({file for mutant in mutants for file in mutant["tests"]}), {}
    noticed = []
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(jobs) as pool:
        cache = Path(folder, "cache")
        shutil.copytree(start, cache) if start else cache.mkdir()
        try:
            for file, run in zip(files, pool.map(lambda file: run_tests([file], cache, extra), files), strict=True):
                print(f"unmutated: {run.cpu_s:4.0f} s, {file}", flush=True)
                alone_s[file] = run.cpu_s
                if run.code != 0:
                    raise SystemExit(f"unmutated test files must pass: {run.failure}")
            for mutant in mutants:
                if sum(alone_s[file] for file in mutant["tests"]) > LIMIT_S / 2:
                    raise SystemExit(f"mutant {mutant['number']}: its test files need more than {LIMIT_S // 2} s")
            runs = pool.map(lambda mutant: run_tests(mutant["tests"], cache, extra, mutant), mutants)
            for mutant, run in zip(mutants, runs, strict=True):
                if run.code in (4, 5):  # pytest's: wrong arguments, no tests
                    raise SystemExit(f"mutant {mutant['number']}: pytest ends with {run.code}")
                noticed.append(run.code != 0)
                result = run.failure if noticed[-1] else "UNNOTICED"
                print(f"{mutant['number']:2}: {run.cpu_s:4.0f} s, {mutant['file']}, {result[:120]}", flush=True)
        finally:
            pool.shutdown(cancel_futures=True)
    return noticed


def draw(seed: int, count: int = 60) -> list[dict]:
    """Return mutants drawn with the seed, not yet tested."""
    from cosmic_ray.ast import ast_nodes, get_ast
    from cosmic_ray.mutating import mutate_code
    from cosmic_ray.operators.provider import OperatorProvider

    provider, sites = OperatorProvider(), {}
    names = [name for name in provider if _is_drawn(name)]
    files = sorted({file for pattern in MODULES for file in (ROOT / "htcp_jax").glob(pattern)})
    for file in (f for f in files if f.name not in NO_MATHEMATICS and not f.name.endswith("_gpu.py")):
        text = file.read_text(encoding="utf-8")
        excluded, nodes = _excluded(ast.parse(text)), list(ast_nodes(get_ast(text)))
        for name in names:
            positions = (p for node in nodes for p in provider[name]().mutation_positions(node))
            for occurrence, (start, _) in enumerate(positions):
                if not any(first <= start < last for first, last in excluded):
                    sites.setdefault((file, start), []).append((name, occurrence))
    chance, drawn = random.Random(seed), []
    for file, _ in chance.sample(sorted(sites), len(sites)):
        name, occurrence = chance.choice(sites[file, _])
        text = file.read_text(encoding="utf-8")
        changed = mutate_code(text, provider[name](), occurrence)
        if _parsed(changed) not in (None, _parsed(text)):  # neither wrong syntax nor brackets alone
            before, after = _lines(text, changed)
            path = file.relative_to(ROOT).as_posix()
            drawn.append({"file": path, "operator": name.replace("core/", ""), "before": before, "after": after})
        if len(drawn) == count:
            break
    tests = {path: _tests_of(path) for path in {mutant["file"] for mutant in drawn}}
    drawn.sort(key=lambda mutant: mutant["file"])
    return [{"number": n, **mutant, "tests": [*tests[mutant["file"]]]} for n, mutant in enumerate(drawn, 1)]


def _is_drawn(name: str) -> bool:
    """Return True if an operator of cosmic-ray stays in its family and can change results."""
    kind, _, pair = name.rpartition("Operator_")
    if kind in ("ReplaceBinary", "ReplaceComparison"):
        return any(set(pair.split("_")) <= set(family.split()) for family in FAMILIES)
    return not name.startswith(("RemoveDecorator", "Variable"))


def _excluded(tree: ast.Module) -> list[tuple]:
    """Return the spans of source, with begin and end as (line, column), that no mutant changes."""
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Raise | ast.JoinedStr | ast.Import | ast.ImportFrom):
            found.append(node)
        found += [part for name in ("annotation", "returns") if (part := getattr(node, name, None))]
        found += getattr(node, "decorator_list", [])
    return [((node.lineno, node.col_offset), (node.end_lineno, node.end_col_offset)) for node in found]


def _parsed(text: str) -> str | None:
    try:
        return ast.dump(ast.parse(text))
    except SyntaxError:
        return None


def _lines(text: str, changed: str) -> tuple[str, str]:
    """Return the changed line before and after, with as many preceding lines as make it unique in the file."""
    old, new = text.splitlines(), changed.splitlines()
    first = next(i for i, (a, b) in enumerate(zip(old, new, strict=False)) if a != b)
    behind = next(i for i, (a, b) in enumerate(zip(old[::-1], new[::-1], strict=False)) if a != b)
    for start in range(first, -1, -1):
        before = "\n".join(old[start : len(old) - behind])
        if f"\n{text}".count(f"\n{before}\n") == 1:
            return before, "\n".join(new[start : len(new) - behind])
    raise AssertionError("the complete file is unique")


@cache
def _public(package: str) -> dict[str, str]:
    """Return the module of each public name of a package, by its stub."""
    stub = ROOT / package.replace(".", "/") / "__init__.pyi"
    tree = ast.parse(stub.read_text(encoding="utf-8") if stub.is_file() else "")
    nodes = [node for node in tree.body if isinstance(node, ast.ImportFrom) and node.module]
    return {alias.name: f"{package}.{node.module}" for node in nodes for alias in node.names}


@cache
def _imported(file: Path) -> dict[str, int]:
    """Return the number of uses of imported names, by module of the package from which a file imports them."""
    tree, names = ast.parse(file.read_text(encoding="utf-8")), {}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and str(node.module).partition(".")[0] == "htcp_jax":
            for alias in node.names:
                whole = f"{node.module}.{alias.name}"
                is_module = (ROOT / f"{whole.replace('.', '/')}.py").is_file()
                home = _public(node.module).get(alias.name, node.module)
                names[alias.asname or alias.name] = whole if is_module else home
    uses = dict.fromkeys(names.values(), 0)
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and node.id in names:
            uses[names[node.id]] += 1
    return uses


@cache
def _has_quick_test(file: Path) -> bool:
    """Return True if a file has a test that is not marked slow."""
    nodes = ast.walk(ast.parse(file.read_text(encoding="utf-8")))
    tests = [node for node in nodes if isinstance(node, ast.FunctionDef) and node.name.startswith("test_")]
    return any("pytest.mark.slow" not in map(ast.unparse, test.decorator_list) for test in tests)


def _tests_of(path: str) -> list[str]:
    """Return the most direct test files of a module, at most TEST_FILES."""
    tests = {file: _imported(file) for file in (ROOT / "tests").glob("test_*.py") if _has_quick_test(file)}
    package = {file: _imported(file) for file in (ROOT / "htcp_jax").rglob("*.py")}
    modules = seen = {path.removesuffix(".py").replace("/", ".")}
    while modules:
        uses = {file: sum(found.get(m, 0) for m in modules) for file, found in tests.items() if modules & found.keys()}
        named = ROOT / f"tests/test_{Path(path).stem.rstrip('_')}.py"
        uses |= {named: sys.maxsize} if named in tests else {}
        if uses:
            best = sorted(uses, key=lambda file: (-uses[file], file))[:TEST_FILES]
            return [file.relative_to(ROOT).as_posix() for file in best]
        importers = {file for file, found in package.items() if modules & found.keys()}
        modules = {".".join(file.relative_to(ROOT).with_suffix("").parts) for file in importers} - seen
        seen = seen | modules
    raise SystemExit(f"no test file reaches {path}")


def main() -> int:
    """Run the mutants, or draw them."""
    split = sys.argv.index("--") if "--" in sys.argv else len(sys.argv)
    parser = argparse.ArgumentParser(prog="python -m benchmarks mutants", description=__doc__.partition("\n")[0])
    parser.add_argument("--only", type=lambda text: {int(n) for n in text.split(",")}, metavar="N,...")
    parser.add_argument("--jobs", type=int, default=1, help="mutants that run at the same time")
    parser.add_argument("--cache", type=Path, metavar="DIR", help="compiled programs, e.g. ~/.cache/htcp_jax")
    parser.add_argument("--record", action="store_true", help="write to mutants.yaml which mutants are noticed")
    parser.add_argument("--draw", type=int, metavar="SEED", help="replace the list by mutants drawn with this seed")
    chosen, extra = parser.parse_args(sys.argv[1:split]), sys.argv[split + 1 :]
    if chosen.draw is not None:
        _write(draw(chosen.draw))
        return 0
    mutants = yaml.safe_load(LIST.read_text(encoding="utf-8"))
    run = [mutant for mutant in mutants if not chosen.only or mutant["number"] in chosen.only]
    if unknown := (chosen.only or set()) - {mutant["number"] for mutant in run}:
        parser.error(f"--only: no mutant {min(unknown)}; the numbers are 1 to {len(mutants)}")
    before = [mutant.get("noticed") for mutant in run]
    noticed = check(run, chosen.jobs, chosen.cache, extra)
    for mutant, found in zip(run, noticed, strict=True):
        mutant["noticed"] = found
    lost = [mutant["number"] for mutant, was, found in zip(run, before, noticed, strict=True) if was and not found]
    print(f"{sum(noticed)} of {len(run)} are noticed; noticed before and not now: {lost or 'none'}")
    if chosen.record:
        _write(mutants)
    return 1 if lost and not chosen.record else 0


def _write(mutants: list[dict]) -> None:
    LIST.write_text(yaml.safe_dump(mutants, sort_keys=False, width=1000), encoding="utf-8")

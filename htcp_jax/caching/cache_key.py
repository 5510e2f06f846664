"""Names of files in the cache folder: digests of everything that an executable or a result depends on.

An executable has two names. `source_key` needs no tracing. It is the digest of the core's source, the versions of
libraries, the processor or GPU, and a lane function with its settings and the shapes and static parts of its arguments.
Static parts, in the structure of the pytree, are described by their contents. Classes and functions are described by
their names, as the digest of the core's source covers their code. A result has one name, `result_key`.

Lane functions that depend on code of another package or of a notebook have no `source_key`. Every process traces them,
and then finds the executable by `program_key`, the digest of the program's text. `program_key` also finds programs that
are still the same after a change of the source.

In a process that has replaced a function of the core, as in a notebook or a test, `source_key` is None, too. Replacing
other attributes of modules at run time does not change a name: set HTCP_CACHE=off in this case.
"""

import dataclasses
import enum
import hashlib
import itertools
import os
import platform
import re
import sys
from functools import cache, partial
from importlib.metadata import version
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

import jax
import numpy as np

PACKAGE, ROOT = __name__.partition(".")[0], Path(__file__).parents[1]
# packages with code that lane functions use
CORE = "caching", "spec", "model", "solvers", "clearance", "device", "motion", "planning", "sequencing", "reachability"
LIBRARIES = "jax", "jaxlib", "numpy", "optax"  # libraries that lane functions use
INSTALLED = Path(jax.__file__).parents[1]  # folder of the installed libraries
WRAPPERS = (classmethod, staticmethod, partial, type(jax.jit(len)), jax.custom_jvp, jax.custom_vjp, FunctionType)
WITHOUT_EFFECT = re.compile("cache|platforms|default_device|log|traceback|dump")  # names of JAX settings
PROCESSOR = re.compile(
    "^(model name|flags|features|cpu (implementer|part|variant))\t*:.*", re.IGNORECASE | re.MULTILINE
)


class UnknownSource(Exception):
    """Error for an object that depends on code outside the core, or cannot be described alike in every process."""


def source_key(
    function: Any, values: tuple, device: jax.Device, options: dict, structure: Any, shapes: tuple
) -> str | None:
    """Return the name of an executable, the same in every process; None if it depends on unknown code.

    Args:
        function: The lane function.
        values: Values of the settings that the function reads.
        device: The device that the function is compiled for.
        options: Options of the compiler.
        structure: Structure of the arguments' pytree.
        shapes: Shape and type of every leaf.
    """
    try:
        about = _source(), described((function, values, shapes)), _described_structure(structure)
    except UnknownSource:
        return None
    return _name(function.name, (_machine(device, options), about))


def program_key(name: str, lowered: jax.stages.Lowered, device: jax.Device, options: dict) -> str:
    """Return the name of an executable as a digest of its program's text, the device and the libraries.

    Args:
        name: Name of the lane function.
        lowered: The program.
        device: The device that the program is compiled for.
        options: Options of the compiler.
    """
    return _name(name, (_machine(device, options), lowered.as_text(), str(lowered.out_tree)))


def result_key(function: FunctionType, about: tuple) -> str | None:
    """Return the name of a function's result, the same in every process; None if it depends on unknown code.

    Args:
        function: A function of the core.
        about: Description of its arguments by `described`; they determine the result.
    """
    try:
        libraries = _installation(), version("scipy")
        return _name(function.__name__, (_source(), libraries, described(function), about))
    except UnknownSource:
        return None


def preparation_key(device: jax.Device) -> str | None:
    """Return the name of a note that `htcp prepare` has compiled for the device; None if the source is unknown."""
    try:
        return _name("prepared", (_machine(device, {}), _source()))
    except UnknownSource:
        return None


def _name(function: str, about: tuple) -> str:
    digest = hashlib.blake2b(repr(about).encode(), digest_size=24)
    return f"{re.sub('[^a-z0-9_]', '-', function)}-{digest.hexdigest()}"


def _machine(device: jax.Device, options: dict) -> tuple:
    """Return a description of the libraries, their configuration, the device and the compiler's options."""
    client = device.client.platform_version if device.platform != "cpu" else ""
    what = (
        device.platform,
        device.device_kind,
        device.id,
        client,
        os.environ.get("XLA_FLAGS", ""),
        sorted(options.items()),
    )
    settings = [f"{name}={value}" for name, value in jax.config.values.items() if not WITHOUT_EFFECT.search(name)]
    return _installation(), what, sorted(settings)


def _source() -> str:
    """Return the digest of the core's source.

    Raises:
        UnknownSource: If a file cannot be read or has changed since this process imported the package, or if a function
            of the core was replaced.
    """
    if _has_replaced_functions():
        raise UnknownSource
    try:
        imported_s = vars(sys.modules[PACKAGE])["_imported_s"]
        known = [os.stat(file) for file in _source_files()]
        # st_ctime: if a file is replaced by another one, st_mtime may be older than the replacement
        if max(max(each.st_mtime, each.st_ctime) for each in known) >= imported_s:
            raise UnknownSource
        return _source_digest()
    except OSError:
        raise UnknownSource from None


def _has_replaced_functions() -> bool:
    """Return True if any function in the core's modules and classes reads globals of a program, notebook or test."""
    for name, module in sys.modules.copy().items():
        package, *inner = name.split(".")
        if package == PACKAGE and (len(inner) < 2 or inner[0] in CORE):
            own = vars(module)
            values = list(own.values())
            methods = (vars(each).values() for each in values if isinstance(each, type) and each.__module__ == name)
            if any(_reads_others(each, own) for each in itertools.chain(values, *methods) if type(each) in WRAPPERS):
                return True
    return False


def _reads_others(function: Any, own: dict[str, Any]) -> bool:
    """Return True if a function, or one that it wraps, reads globals of a program, notebook or test."""
    while type(function) in WRAPPERS:
        read = getattr(function, "__globals__", own)
        if read is not own and not _is_installed(read.get("__name__", PACKAGE)):
            return True
        function = function.func if isinstance(function, partial) else getattr(function, "__wrapped__", None)
    return False


@cache
def _is_installed(module: str) -> bool:
    """Return True if a module is of this package, of Python or of a library; False for a program, notebook or test."""
    package = module.partition(".")[0]
    known = package == PACKAGE or package in sys.stdlib_module_names or module.startswith("namedtuple_")
    return known or Path(getattr(sys.modules.get(package), "__file__", None) or "").is_relative_to(INSTALLED)


@cache
def _source_files() -> tuple[Path, ...]:
    return tuple(sorted([*ROOT.glob("*.py"), *(file for name in CORE for file in (ROOT / name).rglob("*.py"))]))


@cache
def _source_digest() -> str:
    digest = hashlib.blake2b()
    for file in _source_files():
        content = file.read_bytes()
        digest.update(f"{file.relative_to(ROOT).as_posix()} {len(content)} ".encode() + content)
    return digest.hexdigest()


@cache
def _installation() -> tuple[str, ...]:
    """Return the versions of Python and of libraries, and the processor."""
    return sys.version, *(version(name) for name in LIBRARIES), *_processor()


def _processor() -> tuple[str, ...]:
    try:
        lines = {found.group() for found in PROCESSOR.finditer(Path("/proc/cpuinfo").read_text())}
    except OSError:  # not Linux
        lines = {platform.processor()}
    return platform.system(), platform.machine(), *sorted(lines)


def _described_structure(structure: Any) -> tuple:
    node = structure.node_data()
    if node is None:  # a leaf
        return ()
    kind, static = node
    return described(kind), described(static), tuple(map(_described_structure, structure.children()))


def described(value: Any) -> Any:
    """Return a description of an object by plain values and tuples, with the same text in every process.

    Raises:
        UnknownSource: If the object has no such description.
    """
    if value is None or (isinstance(value, bool | int | float | str | bytes) and type(value).__module__ == "builtins"):
        return value
    if isinstance(value, type | FunctionType):
        return _described_code(value)
    of = _described_code(type(value))
    if isinstance(value, enum.Enum):
        return of, value.name
    if isinstance(value, np.ndarray | np.generic):
        digest = hashlib.blake2b(np.ascontiguousarray(value), digest_size=24)
        return of, value.dtype.str, value.shape, digest.hexdigest()
    if isinstance(value, np.dtype):
        return of, value.str
    if isinstance(value, partial):
        return of, *map(described, (value.func, value.args, value.keywords))
    if isinstance(value, tuple | list):
        return of, tuple(map(described, value))
    if isinstance(value, dict):
        return of, tuple((described(key), described(each)) for key, each in value.items())
    if isinstance(value, set | frozenset):
        return of, tuple(sorted(map(repr, map(described, value))))
    if dataclasses.is_dataclass(value):
        return of, tuple((field.name, described(getattr(value, field.name))) for field in dataclasses.fields(value))
    raise UnknownSource(value)


def _described_code(value: type | FunctionType) -> tuple:
    """Return a description of a class or function of the core, or of a class of Python or of the libraries."""
    package, *inner = value.__module__.split(".")
    if isinstance(value, type) and package in ("builtins", "functools", *LIBRARIES):
        return value.__module__, value.__qualname__
    if package != PACKAGE or (len(inner) > 1 and inner[0] not in CORE):
        raise UnknownSource(value)
    known = _named(value.__module__, value.__qualname__)
    if value in (known, getattr(known, "__wrapped__", None)):
        return value.__module__, value.__qualname__
    if not isinstance(value, FunctionType):
        raise UnknownSource(value)
    cells = tuple(described(cell.cell_contents) for cell in value.__closure__ or ())
    return value.__module__, _described_bytes(value.__code__), cells, described(value.__defaults__)


def _named(module: str, name: str) -> Any:
    found: Any = sys.modules.get(module)
    for part in name.split("."):
        found = getattr(found, part, None)
    return found


def _described_bytes(code: CodeType) -> tuple:
    """Return a description of a function that has no name in its module: its place in the source, and its bytecode."""
    constants = tuple(
        _described_bytes(each) if isinstance(each, CodeType) else described(each) for each in code.co_consts
    )
    return code.co_firstlineno, code.co_code, code.co_names, code.co_varnames, constants

"""Names of executables on disk: digests of all that an executable depends on.

`source_key` needs no tracing. It is of the core's source, the libraries, the processor or GPU, and a lane function with
the values, shapes and static parts of its arguments. The static parts are in the structure of the pytree. They are
described by their contents, and names of classes and functions stand for their source. So they must be the core's own:
what depends on the code of another package or of a notebook is traced in every process, and then found by
`program_key`, the digest of the program's text. So is a program that a change of the source did not change.

A process that has replaced a function of the core, as in a notebook or a test, gets no such name either. Other values
of modules that are replaced at run time do not change a name: that is for HTCP_CACHE=off.
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

PACKAGE, ROOT = __name__.partition(".")[0], Path(__file__).parent.parent
CORE = "model", "solvers", "clearance", "device", "motion", "planning", "reachability"  # of lane functions
LIBRARIES = "jax", "jaxlib", "numpy", "optax"  # that they use
INSTALLED = Path(jax.__file__).parents[1]  # where libraries are
WRAPPERS = (classmethod, staticmethod, partial, type(jax.jit(len)), jax.custom_jvp, jax.custom_vjp, FunctionType)
WITHOUT_EFFECT = re.compile("cache|platforms|default_device|log|traceback|dump")  # on programs, of JAX's configuration
PROCESSOR = re.compile(
    "^(model name|flags|features|cpu (implementer|part|variant))\t*:.*", re.IGNORECASE | re.MULTILINE
)


class UnknownSource(Exception):
    """An object is of other code than the core's, or has no description that another process would give as well."""


def source_key(
    function: Any, values: tuple, device: jax.Device, options: dict, structure: Any, shapes: tuple
) -> str | None:
    """Return the name of an executable, the same in every process; None if it depends on unknown code.

    Args:
        function: The lane function.
        values: Values of the settings that it reads.
        device: The device that it is compiled for.
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
    """Return the name of an executable by the text of its program, which has all of its arguments.

    Args:
        name: Name of the lane function.
        lowered: The program.
        device: The device that it is compiled for.
        options: Options of the compiler.
    """
    return _name(name, (_machine(device, options), lowered.as_text(), str(lowered.out_tree)))


def _name(function: str, about: tuple) -> str:
    digest = hashlib.blake2b(repr(about).encode(), digest_size=24)
    return f"{re.sub('[^a-z0-9_]', '-', function)}-{digest.hexdigest()}"


def _machine(device: jax.Device, options: dict) -> tuple:
    """Describe the libraries, their configuration, the device and the compiler's options."""
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
    """Digest of the core's source.

    Raises:
        UnknownSource: If a file changed since this process imported the package, or cannot be read; if a function of
            the core was replaced.
    """
    if _has_replaced_functions():
        raise UnknownSource
    try:
        imported_s = vars(sys.modules[PACKAGE])["_imported_s"]
        known = [os.stat(file) for file in _source_files()]
        # st_ctime: a file that replaces another one may bring an older time along
        if max(max(each.st_mtime, each.st_ctime) for each in known) >= imported_s:
            raise UnknownSource
        return _source_digest()
    except OSError:
        raise UnknownSource from None


def _has_replaced_functions() -> bool:
    """Tell whether a module or class of the core has a function that reads globals of a program, notebook or test."""
    for name, module in list(sys.modules.items()):
        package, *inner = name.split(".")
        if package == PACKAGE and (len(inner) < 2 or inner[0] in CORE):
            own = vars(module)
            values = list(own.values())
            methods = (vars(each).values() for each in values if isinstance(each, type) and each.__module__ == name)
            if any(_reads_others(each, own) for each in itertools.chain(values, *methods) if type(each) in WRAPPERS):
                return True
    return False


def _reads_others(function: Any, own: dict[str, Any]) -> bool:
    """Tell whether a function, or one that it wraps, reads globals of a program, notebook or test; not its module's."""
    while type(function) in WRAPPERS:
        read = getattr(function, "__globals__", own)
        if read is not own and not _is_installed(read.get("__name__", PACKAGE)):
            return True
        function = function.func if isinstance(function, partial) else getattr(function, "__wrapped__", None)
    return False


@cache
def _is_installed(module: str) -> bool:
    """Tell whether a module is of this package, of Python or of a library, and not a program, notebook or test."""
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
    """Versions of Python and of libraries, and the processor."""
    return sys.version, *(version(name) for name in LIBRARIES), *_processor()


def _processor() -> tuple[str, ...]:
    try:
        lines = {found.group() for found in PROCESSOR.finditer(Path("/proc/cpuinfo").read_text())}
    except OSError:  # no Linux
        lines = {platform.processor()}
    return platform.system(), platform.machine(), *sorted(lines)


def _described_structure(structure: Any) -> tuple:
    node = structure.node_data()
    if node is None:  # a leaf
        return ()
    kind, static = node
    return described(kind), described(static), tuple(map(_described_structure, structure.children()))


def described(value: Any) -> Any:
    """Return a description by plain values and tuples, whose text is the same in every process.

    Raises:
        UnknownSource: If there is none.
    """
    if value is None or (isinstance(value, bool | int | float | str | bytes) and type(value).__module__ == "builtins"):
        return value
    if isinstance(value, type | FunctionType):
        return _described_code(value)
    of = _described_code(type(value))
    if isinstance(value, enum.Enum):
        return of, value.name
    if isinstance(value, np.ndarray | np.generic):
        return of, value.dtype.str, value.shape, np.ascontiguousarray(value).tobytes()
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
    """Describe a class or a function of the core, or a class of Python or of the libraries."""
    package, *inner = value.__module__.split(".")
    if isinstance(value, type) and package in ("builtins", "functools", *LIBRARIES):
        return value.__module__, value.__qualname__
    if package != PACKAGE or (len(inner) > 1 and inner[0] not in CORE):
        raise UnknownSource(value)
    if _named(value.__module__, value.__qualname__) is value:
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
    """Describe a function without a name in its module: by its place, and by its bytecode, as a line may hold two."""
    constants = tuple(
        _described_bytes(each) if isinstance(each, CodeType) else described(each) for each in code.co_consts
    )
    return code.co_firstlineno, code.co_code, code.co_names, code.co_varnames, constants

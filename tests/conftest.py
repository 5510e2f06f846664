"""Shared fixtures; strict JAX (no implicit promotion of ranks and dtypes), with compiled programs kept between runs."""

import contextlib
import ctypes
import gc
import os
import shutil
import signal
import warnings
from pathlib import Path

import hypothesis
import jax
import pytest

from htcp_jax.caching import cache_folder
from htcp_jax.errors import InputError

jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_numpy_dtype_promotion", "strict")
cache_folder.enable()
gc.set_threshold(100_000, 20, 20)  # tracing makes many objects, which default thresholds visit again and again
MEMORY, MOST_GB = Path("/proc/self/statm"), 3.5  # of each worker, between test files
hypothesis.settings.register_profile("patient", deadline=None)  # no test depends on how busy the machine is
hypothesis.settings.load_profile("patient")
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:  # in the background of a script, whose children would inherit it
    signal.signal(signal.SIGINT, signal.default_int_handler)

collect_ignore = ["text"]  # tests that read files only, which `make lint` runs without this file

BROWSERS = "chromium", "chromium-browser", "chromium-headless-shell", "google-chrome"
REBOUND = "rebound.test"  # a name that the browser resolves to this machine, as in DNS rebinding
FLAGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
FLAGS += [f"--host-resolver-rules=MAP {REBOUND} 127.0.0.1"]


@pytest.fixture(autouse=True, scope="module")
def free_memory():
    """Give memory back to the system and, if that is not enough, clear compiled programs.

    Programs also use memory maps. A process may have 65,530, which a worker reaches at 20 GB.
    """
    yield
    if _memory_gb() < MOST_GB:
        return
    _collect()
    if (size := _memory_gb()) >= MOST_GB:
        from htcp_jax.device.executor import EXECUTABLES  # here, as in `no_lines_of_progress`

        jax.clear_caches()
        EXECUTABLES.clear()
        _collect()
        warnings.warn(f"compiled programs were cleared at {size:.1f} GB", pytest.PytestWarning, stacklevel=1)


def _memory_gb() -> float:
    """Return the memory that this process holds [GB]; as much as possible where it is unknown."""
    return int(MEMORY.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e9 if MEMORY.exists() else MOST_GB


def _collect() -> None:
    gc.collect()
    with contextlib.suppress(AttributeError):  # the C library is not glibc
        ctypes.CDLL(None).malloc_trim(0)


@pytest.fixture(autouse=True, scope="session")
def no_lines_of_progress():
    """Switch progress lines off, so that the output of commands does not depend on the load of the machine."""
    from htcp_jax.cli import heartbeat  # here, because what is imported before the tests has unchecked annotations

    heartbeat.LINE_S = 3600.0


@pytest.fixture(scope="session")
def planned(tmp_path_factory):
    """Folder with a small real run, see small_run.py; read-only."""
    from small_run import plan_small_run

    return plan_small_run(tmp_path_factory.mktemp("planned"))


@pytest.fixture(scope="session")
def screenless():
    """Skip the test where OpenGL is missing."""
    from htcp_jax.viewer import offscreen  # here, as few tests draw

    try:
        offscreen.platform()
    except InputError as missing:
        pytest.skip(str(missing))


@pytest.fixture
def opengl(tmp_path_factory, monkeypatch):
    """Function that leaves only these platforms of off-screen OpenGL, in every process that tries one."""
    from htcp_jax.viewer import offscreen  # here, as few tests draw

    def only(*platforms: str) -> None:
        folder = tmp_path_factory.mktemp("opengl") / "mujoco"
        folder.mkdir()
        (folder / "__init__.py").write_text("from unittest.mock import Mock\nMjrContext = MjModel = Mock()\n")
        for name in platforms:
            (folder / f"{name}.py").write_text("from unittest.mock import Mock\nGLContext = Mock()\n")
        monkeypatch.setenv("PYTHONPATH", str(folder.parent))
        monkeypatch.delenv("MUJOCO_GL", raising=False)
        offscreen.platform.cache_clear()

    yield only
    offscreen.platform.cache_clear()


@pytest.fixture(scope="module")
def browser():
    """Headless browser; skips the test where none is installed."""
    driver = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed (extra `test`)")
    found = next(filter(None, map(shutil.which, BROWSERS)), None)
    if found is None:
        pytest.skip(f"no browser is installed (one of {', '.join(BROWSERS)})")
    with driver.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=found, args=FLAGS)
        yield browser
        browser.close()

"""Strict JAX for every test: ranks are never promoted in silence; compiled programs are kept between runs."""

import signal

import hypothesis
import jax
import pytest

from htcp_jax.errors import InputError
from htcp_jax.planner import compile_cache

jax.config.update("jax_numpy_rank_promotion", "raise")
compile_cache.enable()
hypothesis.settings.register_profile("patient", deadline=None)  # no test depends on how busy the machine is
hypothesis.settings.load_profile("patient")
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:  # in the background of a script, whose children would inherit it
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(autouse=True, scope="module")
def forget_programs():
    """Every compiled program maps memory, and a process may have 65,530 maps: past that the compiler crashes."""
    yield
    jax.clear_caches()


@pytest.fixture(scope="session")
def planned(tmp_path_factory):
    """The folder with a small real run, see small_run.py; not to be changed."""
    from small_run import plan_small_run  # here, because what is imported before the tests has unchecked annotations

    return plan_small_run(tmp_path_factory.mktemp("planned"))


@pytest.fixture(scope="session")
def screenless():
    """Skips a test where OpenGL is missing."""
    from htcp_jax.viewer import offscreen  # here, as few tests draw

    try:
        offscreen.platform()
    except InputError as missing:
        pytest.skip(str(missing))

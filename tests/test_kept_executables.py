"""Executables kept on disk: another process loads them without tracing; nothing but one's own files is ever loaded."""

import dataclasses
import functools
import os
import pickle
import shutil
import subprocess
import sys
from functools import partial
from types import SimpleNamespace

import jax
import lint
import made_once
import numpy as np
import pytest
import toy
from jax.experimental.compilation_cache import compilation_cache

import htcp_jax
from htcp_jax import numerics
from htcp_jax.caching import cache_folder, cache_key
from htcp_jax.caching import decorators as caching
from htcp_jax.cli.main import _warn, main
from htcp_jax.device import Executor, kept_executables
from htcp_jax.device.executor import COMPILER, ExecutableCache
from htcp_jax.device.lane_function import STEP, LaneFunction
from htcp_jax.errors import InputError
from htcp_jax.model import duct, kinematics, mesh_points
from htcp_jax.model.robot import Robot
from htcp_jax.model.scenario import stack
from htcp_jax.motion.lane_inputs import lane_inputs
from htcp_jax.motion.step_functions import SETTLE, TIP
from htcp_jax.planning.methods import BUILT_IN

TRACING = "/jax/core/compile/jaxpr_trace_duration"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The folder of compiled programs, new for this test."""
    toy.scene()  # now, so that none of its results is stored in the folder
    before = jax.config.jax_compilation_cache_dir
    jax.config.update("jax_compilation_cache_dir", None)
    monkeypatch.setenv("HTCP_CACHE", str(tmp_path / "cache"))
    compilation_cache.reset_cache()
    yield cache_folder.enable()
    jax.config.update("jax_compilation_cache_dir", before)
    compilation_cache.reset_cache()


def settled(scene=None):
    """Results of a new process: executables in memory are not shared with other calls."""
    inputs = lane_inputs(jax.tree.map(np.asarray, stack(toy.scenarios())), np.zeros(3, int), np.arange(3))
    q = np.tile(toy.START, (3, 1)) + 0.1 * np.arange(12.0).reshape(3, 4)
    return Executor(scene or toy.scene(), toy.SETTINGS, executables=ExecutableCache(on_disk=True))(SETTLE, inputs, q)


def traced(call):
    """The number of functions that JAX traces during a call, and its result."""
    events = []
    note = lambda event, *_, **__: events.append(event) if event == TRACING else None  # noqa: E731
    jax.monitoring.register_event_duration_secs_listener(note)
    try:
        return call(), len(events)
    finally:
        jax.monitoring.unregister_event_duration_listener(note)


def files(folder):
    """The short file that names the program, and the program."""
    return sorted((folder / cache_folder.STORED).iterdir(), key=lambda file: file.stat().st_size)


def test_what_one_process_compiled_another_one_loads_without_tracing_with_equal_bits(folder):
    first, count = traced(settled)
    assert count and [file.name.partition("-")[0] for file in files(folder)] == ["settle", "settle"]
    jax.clear_caches()
    second, count = traced(settled)
    assert count == 0 and first.tobytes() == second.tobytes()


def test_arms_that_differ_in_names_and_frames_share_an_executable(folder):
    first = settled()
    renamed = dataclasses.replace(toy.robot(), name="other", joint_names=tuple("abcd"), frames=())
    second, count = traced(lambda: settled(toy.scene()._replace(robot=renamed)))
    assert count == 0 and first.tobytes() == second.tobytes()


@pytest.mark.parametrize("number", [0, 1])
@pytest.mark.parametrize("damage", [lambda data: data[:-1], lambda data: b"", lambda data: b"x" + data[1:]])
def test_a_damaged_file_is_compiled_anew_and_replaced(folder, number, damage):
    first, file = settled(), files(folder)[number]
    file.write_bytes(damage(file.read_bytes()))
    for programs in folder.glob("*-cache"):  # of JAX's own cache
        programs.unlink()
    with pytest.warns(UserWarning, match="has damaged files"):
        assert settled().tobytes() == first.tobytes()
    assert traced(settled)[1] == 0


def test_a_folder_of_damaged_files_is_one_line_of_the_command(folder, capsys):
    first = settled()
    for file in [*files(folder), *folder.glob("*-cache")]:
        file.write_bytes(file.read_bytes()[:100])
    jax.clear_caches()
    with pytest.warns(UserWarning) as noted:
        assert settled().tobytes() == first.tobytes()
    texts = [str(each.message) for each in noted]
    assert cache_folder.damaged() in texts and any(text.startswith(cache_folder.UNREADABLE) for text in texts)
    shown = set()
    for each in noted:
        _warn(each.message, shown=shown)
    assert capsys.readouterr().err == f"htcp: warning: {cache_folder.damaged()}\n"


def test_a_program_from_jax_s_cache_is_right_and_not_stored(folder):
    """It cannot be serialised a second time."""
    first = settled()
    files(folder)[1].unlink()
    assert settled().tobytes() == first.tobytes() and len(files(folder)) == 1


def test_source_that_changed_without_effect_compiles_nothing(folder):
    first = settled()
    files(folder)[0].unlink()  # the name that depends on the source
    compiled = folder.glob("*-cache")
    for programs in compiled:
        programs.unlink()
    second, count = traced(settled)
    assert count and second.tobytes() == first.tobytes() and not list(folder.glob("*run*-cache"))
    assert traced(settled)[1] == 0


@pytest.mark.filterwarnings("ignore:.* has damaged files")
def test_a_file_of_another_executable_is_not_unpickled(folder):
    settled()
    *_, file = files(folder)
    other = file.with_name(file.name[:-1] + ("0" if file.name[-1] != "0" else "1"))
    shutil.copy(file, other)
    assert cache_folder.read(file.name) and cache_folder.read(other.name) is None


def test_content_that_does_not_load_is_done_without(folder):
    cache_folder.write("a-0", b"a-1")
    cache_folder.write("a-1", b"no executable")
    assert cache_folder.read("a-1") == b"no executable"
    assert kept_executables.find("a-0", jax.devices()[0], ()) is None


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="no permissions here")
@pytest.mark.parametrize("mode", [0o755, 0o770, 0o702])
def test_executables_are_read_only_from_a_folder_of_the_user_alone(folder, mode):
    settled()
    file, _ = files(folder)
    file.parent.chmod(mode)
    assert cache_folder.read(file.name) is None
    file.parent.chmod(0o700)
    assert cache_folder.read(file.name)


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="no permissions here")
@pytest.mark.parametrize("mode", [0o770, 0o702])
def test_a_folder_that_others_can_write_is_refused_in_one_line(folder, mode, capsys):
    jax.config.update("jax_compilation_cache_dir", None)
    folder.chmod(mode)
    with pytest.raises(InputError, match=f"chmod 700 {folder}"):
        cache_folder.enable()
    assert main(["doctor"]) == 2 and capsys.readouterr().err.count("\n") == 1


def test_files_that_were_not_used_for_the_longest_time_are_removed(folder, monkeypatch):
    for age, name in enumerate(("new", "used", "old")):
        cache_folder.write(name, bytes(1000))
        os.utime(folder / cache_folder.STORED / name, (1e9 - age, 1e9 - age))
    (folder / "jit_old-cache").write_bytes(bytes(1000))  # of JAX's own cache
    os.utime(folder / "jit_old-cache", (1e8, 1e8))
    (folder / "thesis.txt").write_bytes(bytes(1000))  # of somebody else
    os.utime(folder / "thesis.txt", (1e7, 1e7))
    assert cache_folder.read("used")
    monkeypatch.setattr(cache_folder, "MOST_BYTES", 3500)
    cache_folder.write("last", bytes(1000))
    assert {file.name for file in files(folder)} == {"last", "new", "used"} and not (folder / "jit_old-cache").exists()
    assert (folder / "thesis.txt").exists()


def test_the_size_of_the_folder_is_measured_at_the_first_write_and_when_a_sixteenth_of_the_limit_is_written(
    folder, monkeypatch
):
    monkeypatch.setattr(cache_folder, "MOST_BYTES", 100_000)
    large = folder / "jit_large-cache"

    def write(count: int) -> bool:
        """Write a file next to another one that is too large; return True if the large one is removed."""
        large.write_bytes(bytes(120_000))
        os.utime(large, (1e8, 1e8))
        cache_folder.write(f"{count}", bytes(count))
        return not large.exists()

    assert [write(count) for count in (1000, 2000, 3000, 4000, 5000)] == [True, False, False, True, False]


def key_of(lane_function, settings=toy.SETTINGS, tables=(), scene=None):
    leaves, structure = jax.tree.flatten(((scene or toy.scene()).for_programs(), *tables))
    shapes = tuple((np.shape(leaf), np.asarray(leaf).dtype) for leaf in leaves)
    device = jax.devices()[0]
    values = lane_function.values(settings)
    return cache_key.source_key(lane_function, values, device, COMPILER["cpu"], structure, shapes)


def built_in():
    """Lane functions of the built-in methods' stages."""
    return [stage.lane_function(k) for method in BUILT_IN for k, stage in enumerate(getattr(method, "stages", ()))]


def test_names_are_the_same_in_every_process():
    code = "import test_kept_executables as t; print(*[t.key_of(each) for each in (t.SETTLE, t.TIP, *t.built_in())])"
    known = [key_of(each) for each in (SETTLE, TIP, *built_in())]
    assert None not in known and len(set(known)) == 2 + len(set(built_in()))
    flags = {name: str(getattr(jax.config, name)) for name in ("jax_numpy_rank_promotion", "jax_numpy_dtype_promotion")}
    for seed in "1", "2":
        env = {**os.environ, "PYTHONHASHSEED": seed, **{name.upper(): value for name, value in flags.items()}}
        found = subprocess.run([sys.executable, "-c", code], cwd="tests", env=env, capture_output=True, check=True)
        assert found.stdout.decode().split() == known


def test_a_name_stands_for_the_scene_the_settings_and_the_shapes():
    small = made_once.scene()
    lane_function = BUILT_IN[3].stages[0].lane_function(0)
    names = [key_of(TIP), key_of(TIP, tables=(np.zeros(3),)), key_of(TIP, tables=(np.zeros(4),)), key_of(SETTLE)]
    names += [key_of(TIP, tables=(np.zeros(4, np.float32),)), key_of(TIP, scene=small), key_of(lane_function)]
    names.append(key_of(lane_function, dataclasses.replace(toy.SETTINGS, alpha_rad=0.123)))
    assert len(set(names)) == len(names)


def test_code_of_others_has_no_name():
    """Source that is not the core's may change without the name."""

    @dataclasses.dataclass(frozen=True)
    class Row:
        link: int

    for own in (Row(1), key_of, lambda x: x, partial(key_of, 1), object(), LaneFunction("own", key_of, STEP)):
        with pytest.raises(cache_key.UnknownSource):
            cache_key.described((own,))
    assert (
        key_of(LaneFunction("own", key_of, STEP)) is None and key_of(LaneFunction("a", abs, STEP, parts=(Row,))) is None
    )


def test_source_that_changed_while_the_process_runs_has_no_name(monkeypatch):
    """The process may run what was in the file before."""
    assert key_of(TIP)
    newest = max(file.stat().st_mtime for file in cache_key._source_files())
    monkeypatch.setattr(htcp_jax, "_imported_s", newest)
    assert key_of(TIP) is None


def test_source_that_was_replaced_by_an_older_file_has_no_name(monkeypatch):
    """As by `cp -p` or rsync: the file brings its time along."""
    now = htcp_jax._imported_s
    for changed, is_named in ((now - 1, True), (now + 1, False)):
        known = SimpleNamespace(st_mtime=0.0, st_ctime=changed)
        monkeypatch.setattr(cache_key, "os", SimpleNamespace(stat=lambda _: known, environ=os.environ))  # noqa: B023
        assert (key_of(TIP) is not None) == is_named


def wraps_tcp(own=kinematics.tcp_position):
    return functools.wraps(own)(lambda *arguments: own(*arguments))


@pytest.mark.parametrize(
    "replaced",
    [key_of, wraps_tcp(), jax.jit(wraps_tcp()), jax.vmap(key_of), partial(key_of), jax.custom_jvp(key_of)],
)
def test_a_process_that_replaced_a_function_of_the_core_gets_no_name(monkeypatch, replaced):
    """Neither does it load what others compiled, nor keep its own for others (regression: a fault passed the gate)."""
    assert key_of(TIP)
    monkeypatch.setattr(kinematics, "tcp_position", replaced)
    assert key_of(TIP) is None


def test_a_process_that_replaced_a_function_at_the_package_s_root_gets_no_name(monkeypatch):
    monkeypatch.setattr(numerics, "product", lambda *_: None)
    assert key_of(TIP) is None


def test_a_process_that_replaced_a_method_of_the_core_gets_no_name(monkeypatch):
    monkeypatch.setattr(Robot, "with_tool", lambda self: self, raising=False)
    assert key_of(TIP) is None


def test_the_source_in_a_name_is_that_of_the_core():
    assert list(cache_key.CORE) == lint.PACKAGES[1 : lint.PACKAGES.index("io")]


INVERSE = """
import jax, jax.numpy as jnp, numpy as np
import htcp_jax
from htcp_jax.caching import cache_folder
from htcp_jax.device import kept_executables
cache_folder.enable()
device, x = jax.devices("cpu")[0], (jnp.eye(3) + 0.1,)
found = kept_executables.find("source", device, x)
made = found is None
if made:
    compile_ = jax.jit(jnp.linalg.inv).lower(*x).compile
    found = kept_executables.compiled("source", "program", compile_, device, x)
print(made, np.asarray(found(*x)).tolist())
"""


def test_an_executable_that_calls_lapack_runs_in_a_process_that_only_loads_it(tmp_path):
    """Calls of LAPACK in a loaded executable: their pointers are set (regression: the process ended by a signal)."""
    environment = {**os.environ, "HTCP_CACHE": str(tmp_path / "cache"), "JAX_PLATFORMS": "cpu"}
    command = [sys.executable, "-c", INVERSE]
    runs = [subprocess.run(command, env=environment, capture_output=True, text=True) for _ in range(2)]
    assert [run.returncode for run in runs] == [0, 0], runs[1].stderr
    (first, inverse), (second, loaded) = (run.stdout.split(" ", 1) for run in runs)
    assert (first, second) == ("True", "False") and inverse == loaded


def test_a_slow_result_is_stored_for_the_next_process_and_computed_again_if_its_file_is_damaged(folder, monkeypatch):
    points, drawn = duct.duct_cloud.__wrapped__, duct.duct_cloud.__wrapped__(40)

    def in_a_new_process():
        return caching.cached_by_values(2)(points)(40)

    monkeypatch.setattr(caching, "SLOW_S", np.inf)
    assert np.array_equal(in_a_new_process(), drawn) and not files(folder)
    monkeypatch.setattr(caching, "SLOW_S", 0.0)
    assert np.array_equal(in_a_new_process(), drawn)
    (file,) = files(folder)
    cache_folder.write(file.name, pickle.dumps("stored"))
    assert in_a_new_process() == "stored"
    cache_folder.write(file.name, b"no pickle")
    assert np.array_equal(in_a_new_process(), drawn)


def test_the_points_on_a_mesh_are_stored_for_the_next_process(folder):
    found = mesh_points.cover_mesh(np.array([[[0.0, 0, 0], [0.3, 0, 0], [0, 0.2, 0]]]), "plate", 0.002)
    (file,) = files(folder)
    stored = pickle.loads(cache_folder.read(file.name))
    assert len(found.points) > 10_000 and np.array_equal(stored.points, found.points)
    assert stored.radius_m == found.radius_m


SCENE = """
import sys
from htcp_jax.caching import cache_folder
from htcp_jax.clearance.obstacles.of_workpiece import make_obstacle
from htcp_jax.jobs import build, load_config
cache_folder.enable()
_, workpiece, _ = build.scene(load_config(None, []))
make_obstacle(workpiece)
print(workpiece.largest_gap_m, *(name for name in ("scipy.interpolate", "scipy.spatial") if name in sys.modules))
"""


def test_the_scene_of_the_default_job_is_loaded_a_second_time_without_scipy(tmp_path):
    environment = {**os.environ, "HTCP_CACHE": str(tmp_path / "cache"), "JAX_PLATFORMS": "cpu"}
    command = [sys.executable, "-c", SCENE]
    runs = [subprocess.run(command, env=environment, capture_output=True, text=True) for _ in range(2)]
    (gap, *first), (again, *second) = (run.stdout.split() for run in runs)
    assert gap == again and first == ["scipy.interpolate", "scipy.spatial"] and not second


@pytest.mark.filterwarnings("ignore:.* has damaged files")
def test_programs_that_were_used_last_are_loaded_before_they_are_called(folder, monkeypatch):
    monkeypatch.setattr(kept_executables, "_used", {})
    expected, device = settled(), jax.devices()[0]
    kept_executables.remember("toy")
    kept_executables.preload("toy", device)
    kept_executables.preload("never planned", device)
    (begun,) = kept_executables._begun.values()
    found, count = traced(settled)
    assert count == 0 and begun.executable.done() and not kept_executables._begun
    assert all(map(np.array_equal, jax.tree.leaves(found), jax.tree.leaves(expected)))
    for file in folder.glob(f"{cache_folder.STORED}/settle*"):
        file.write_bytes(b"damaged")
    kept_executables.preload("toy", device)
    again, count = traced(settled)
    assert count > 0 and all(map(np.array_equal, jax.tree.leaves(again), jax.tree.leaves(expected)))

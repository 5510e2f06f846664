"""Malicious folders: commands that open one end soon, with one line, in little memory, and change nothing outside."""

import json
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from hostile import KINDS, SHARD, commands
from made_plan import made_plan
from small_run import toy_run
from sweep_process import environment

from htcp_jax.cli import main
from htcp_jax.errors import InputError
from htcp_jax.runs.timing_file import TIMING
from htcp_jax.system import files
from htcp_jax.system.lock import locked
from htcp_jax.system.unfinished import SCRATCH, clear, temporary_folder

PEAK = 10**9  # bytes
LONGEST_S = 120  # longer than any command takes on any machine
PLACE = "config: job.yaml\nplace: {workpiece.rotation_y_rad: [0.0, 0.1]}\nwithin: {scenarios: 4}\n"
HERE = Path(__file__).parent


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """Folder with a run, a plan and a search, and the files of their jobs."""
    place = shutil.copytree(toy_run(4), tmp_path_factory.mktemp("good") / "place")
    found = {"prefix": [1] * 4, "most": [9] * 4, "resolution_rad": 0.1, "seed": 0}
    (place / "run" / "reachability.json").write_text(json.dumps(found))
    assert main(["gate", str(place / "run"), "--baseline", str(place / "baseline.yaml"), "--update"]) == 0
    made_plan(place / "job").save(place / "plan")
    (place / "place.yaml").write_text(PLACE)
    (place / "search").mkdir()
    return place


def spoiled(good: Path, tmp_path: Path, kind: str) -> tuple[Path, Path, dict[str, list[str]]]:
    """Make a damaged folder and one outside of it; return both and the command lines that open the first."""
    folder, outside = tmp_path / "folder", tmp_path / "outside"
    shutil.copytree(good / KINDS[kind].of, folder)
    outside.mkdir()
    KINDS[kind].spoil(folder, outside)
    return folder, outside, commands(KINDS[kind].of, folder, good)


def contents(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in sorted(folder.rglob("*")) if file.is_file()}


def check(kind: str, command: str, code: int, said: str) -> None:
    """Check for one line and exit code 2 (gate: 1) if the command has to refuse the folder, and no traceback."""
    if command in KINDS[kind].refused_by:
        assert code == (1 if command == "gate" else 2), (command, code, said)
        lines = [line for line in said.splitlines() if not line.startswith(("htcp: warning: ", "htcp: note: "))]
        assert len(lines) == (command != "gate") and all(KINDS[kind].named in line for line in lines), (command, said)
    else:
        assert code in (0, 1, 2, 3), (command, said)
    assert "Traceback" not in said


@pytest.fixture
def in_time():
    """Fail a test that takes too long."""
    before = signal.signal(signal.SIGALRM, lambda *_: pytest.fail("it does not end"))
    signal.alarm(LONGEST_S)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.mark.parametrize("kind", KINDS)
def test_a_command_that_reads_what_a_stranger_has_changed_refuses_it_in_a_line(good, tmp_path, capsys, in_time, kind):
    _, outside, lines = spoiled(good, tmp_path, kind)
    before = contents(outside)
    for command in KINDS[kind].refused_by[-1:]:
        code = main(lines[command])
        check(kind, command, code, capsys.readouterr().err)
    assert contents(outside) == before


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="the peak of memory is read from /proc")
@pytest.mark.parametrize("kind", KINDS)
def test_no_command_waits_fills_the_memory_or_writes_outside_of_a_strangers_folder(good, tmp_path, kind):
    _, outside, lines = spoiled(good, tmp_path, kind)
    if "view" not in KINDS[kind].refused_by:
        lines.pop("view", None)  # it would serve the page without end
    before = contents(outside)
    for command, words in lines.items():
        own = [sys.executable, str(HERE / "hostile.py"), *words]
        done = subprocess.run(own, capture_output=True, timeout=LONGEST_S, cwd=tmp_path, env=environment())
        assert done.returncode == 0, done.stderr.decode()
        found = json.loads(done.stdout)
        check(kind, command, found["code"], found["said"])
        assert found["peak"] < PEAK or command not in KINDS[kind].refused_by, command  # rendering takes more
    assert contents(outside) == before


def test_a_link_inside_the_folder_is_followed(good, tmp_path, capsys):
    folder = shutil.copytree(good / "run", tmp_path / "run")
    (folder / SHARD).rename(folder / "elsewhere")
    (folder / SHARD).symlink_to(folder / "elsewhere")
    assert main(["report", str(folder), "--out", str(tmp_path / "out")]) == 0


def test_what_a_killed_process_left_is_removed_and_what_a_living_one_writes_is_not(tmp_path):
    writer = "import sys, time; from pathlib import Path; from htcp_jax.system.unfinished import temporary_folder\n"
    writer += "with temporary_folder(Path(sys.argv[1])), temporary_folder(): print('made', flush=True); time.sleep(600)"
    place = {"TMPDIR": str(tmp_path / "tmp")}
    (tmp_path / "tmp").mkdir()
    (tmp_path / "run" / TIMING).mkdir(parents=True)
    words = [sys.executable, "-c", writer, str(tmp_path / "run")]
    with subprocess.Popen(words, stdout=subprocess.PIPE, env=environment() | place) as process:
        assert process.stdout.readline() == b"made\n"
        (tmp_path / "run" / TIMING / ".part-0").write_bytes(b"half")
        with locked(tmp_path / "run"):
            assert len(list((tmp_path / "run").glob("**/.part-*"))) == 1
        process.kill()
        process.wait()
    with locked(tmp_path / "run"):
        assert not list((tmp_path / "run").glob("**/.part-*"))
    clear(tmp_path / "tmp", SCRATCH)
    assert not list((tmp_path / "tmp").iterdir())


def test_a_file_is_written_completely_or_not_at_all_and_never_through_a_link(tmp_path):
    (tmp_path / "outside").mkdir()
    folder = tmp_path / "folder"
    folder.mkdir()
    (tmp_path / "outside" / "own").write_text("as it was")
    (folder / "a.json").symlink_to(tmp_path / "outside" / "own")
    (folder / "sub").symlink_to(tmp_path / "outside")
    files.write_atomically(folder, "a.json", b"{}")
    assert not (folder / "a.json").is_symlink() and (folder / "a.json").read_bytes() == b"{}"
    with pytest.raises(InputError, match=r"the file is a link to a place outside .*; such links are not followed"):
        files.write_atomically(folder, "sub/b.json", b"{}")
    assert contents(tmp_path / "outside") == {"own": b"as it was"}
    assert not list(folder.glob(".part-*"))


def test_temporary_folders_have_a_name_of_their_own():
    with temporary_folder() as made:
        assert made.parent == Path(tempfile.gettempdir()) and made.name.startswith("htcp-")
    assert not made.exists()

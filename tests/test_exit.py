"""Exit of commands: prompt exit codes, one line after Ctrl-C or SIGTERM in any phase, and no unfinished files."""

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
import sweep_process
import toy
import trimesh
from test_place import TOY_FILE

from htcp_jax.cli import heartbeat, main, output
from htcp_jax.cli.main import COMMANDS
from htcp_jax.cli.plan import _Search
from htcp_jax.cli.sweep import _sweep_bars
from htcp_jax.planning import batch
from htcp_jax.runs import open_run
from htcp_jax.runs.sweep import SweepProgress, sweep
from htcp_jax.spec import GP50
from htcp_jax.system.unfinished import PART, temporary_folder

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="phases are seen in /proc")
LIMIT_S = 30.0  # 5 on a quiet machine
CODES = 0, 1, 3  # exit codes of commands that end before the signal
WORDS = {
    "plan": "plan job.yaml --out out",
    "program": "program plan --feed 20mm/s --out out/weld.csv --check",
    "robot": f"robot {GP50} --out out/capsules.xml",
    "tool": "tool torch.stl --tip 0,0,0.1 --out out/torch.xml",
    "cell": f"cell {GP50} --tool tcp --part link1 --out out/cell.xml",
    "sweep": "sweep grid.yaml --methods baseline --shard 2 --out out",
    "prove": "prove plan/motion.csv --job job.yaml --out out",
    "report": "report run --out out",
    "validate": "validate run",
    "view": "view plan --port 0",
    "render": "render plan --out out --movie gif",
    "place": "place place.yaml --out out",
    "reachability": "reachability grid.yaml --out out",
    "gate": "gate run --baseline baseline.yaml --markdown out.md",
    "methods": "methods",
    "example": "example pipe out",
    "prepare": "prepare",
    "doctor": "doctor",
}


@pytest.fixture(scope="module")
def swept(tmp_path_factory) -> Path:
    """Folder with jobs, a grid and its run; read-only."""
    folder = tmp_path_factory.mktemp("swept")
    toy.write_sweep(folder, program={"velocity": [2.0] * 4})
    (folder / "place.yaml").write_text(TOY_FILE)
    trimesh.creation.cylinder(radius=0.01, segment=[[0, 0, 0], [0, 0, 0.08]]).export(folder / "torch.stl")
    sweep(folder / "grid.yaml", "baseline", folder / "run")
    return folder


@pytest.fixture(scope="module")
def prepared(swept, tmp_path_factory) -> Path:
    """Folder with the inputs of all commands; read-only."""
    folder = tmp_path_factory.mktemp("prepared")
    shutil.copytree(swept, folder, dirs_exist_ok=True)
    for words in ("plan job.yaml --out plan", "gate run --baseline baseline.yaml --update"):
        done = subprocess.run([sys.executable, "-m", "htcp_jax", *words.split()], cwd=folder, env=environment())
        assert done.returncode == 0
    return folder


@pytest.fixture
def here(swept, tmp_path) -> Path:
    shutil.copytree(swept, tmp_path, dirs_exist_ok=True)
    return tmp_path


@pytest.fixture
def all_here(prepared, tmp_path) -> Path:
    shutil.copytree(prepared, tmp_path, dirs_exist_ok=True)
    return tmp_path


def environment(**more: str) -> dict[str, str]:
    return sweep_process.environment() | more


def start(here: Path, words: str, **more: str) -> subprocess.Popen:
    """Start a command in a folder whose `tmp` gets its temporary files."""
    (here / "tmp").mkdir(exist_ok=True)
    given, pipe = environment(TMPDIR=str(here / "tmp"), **more), subprocess.PIPE
    command = [sys.executable, "-m", "htcp_jax", *words.split()]
    return subprocess.Popen(command, cwd=here, env=given, stdout=pipe, stderr=pipe, text=True)


def wait(process: subprocess.Popen, condition: Callable[[], bool]) -> None:
    while process.poll() is None and not condition():
        time.sleep(0.002)


def handled(process: subprocess.Popen) -> None:
    """Wait until the process handles SIGTERM."""

    def is_handled() -> bool:
        lines = Path(f"/proc/{process.pid}/status").read_text().splitlines()
        mask = next(int(line.split()[1], 16) for line in lines if line.startswith("SigCgt:"))
        return bool(mask >> (signal.SIGTERM - 1) & 1)

    wait(process, is_handled)


def imports(process: subprocess.Popen) -> None:
    """Wait until the process loads libraries."""
    wait(process, lambda: "_multiarray_umath" in Path(f"/proc/{process.pid}/maps").read_text())


def contents(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}


def ended(here: Path, process: subprocess.Popen, numbers: Sequence[int], began: float) -> None:
    """Check exit code, message and files of a process after a signal."""
    _, errors = process.communicate(timeout=LIMIT_S)
    assert time.monotonic() - began < LIMIT_S
    if process.returncode in CODES:  # it ended before the signal
        return
    assert process.returncode == 128 + numbers[0], errors
    (line,) = sweep_process.without_progress(errors)
    assert line.startswith("htcp: ")
    assert contents(here / "tmp") == set() and not [each for each in contents(here) if ".part-" in each]


def interrupt(here: Path, words: str, phase: Callable, *numbers: int, **more: str) -> int:
    process = start(here, words, **more)
    try:
        phase(process)
        began = time.monotonic()
        for number in numbers:
            process.send_signal(number)
            time.sleep(0.6 * (len(numbers) > 1))
        ended(here, process, numbers, began)
        return process.returncode
    finally:
        process.kill()
        process.communicate()


def test_every_command_is_here():
    assert WORDS.keys() == COMMANDS.keys()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("phase", [handled, imports])
def test_a_signal_while_modules_load_is_one_line(here, phase, number):
    before = contents(here)
    assert interrupt(here, WORDS["plan"], phase, number) == 128 + number
    assert contents(here) == before | {"tmp"}


def compiles(here: Path) -> Callable:
    """Wait until a program is being compiled, which creates a lock in the folder of compiled programs."""
    return lambda process: wait(process, lambda: any((here / "cache").glob("*.lock")))


@pytest.mark.parametrize(("command", "number"), [("plan", signal.SIGTERM), ("reachability", signal.SIGINT)])
def test_a_signal_while_a_program_is_compiled_is_one_line_and_removes_what_was_begun(here, command, number):
    before = contents(here)
    cache = str(here / "cache")
    assert interrupt(here, WORDS[command], compiles(here), number, HTCP_CACHE=cache) == 128 + number
    shutil.rmtree(cache)
    assert contents(here) == before | {"tmp"}


def test_a_second_ctrl_c_ends_it_as_the_first_does(here):
    cache = str(here / "cache")
    assert interrupt(here, WORDS["plan"], compiles(here), signal.SIGINT, signal.SIGINT, HTCP_CACHE=cache) == 130
    assert not (here / "out").exists()


def test_a_sweep_that_compiles_keeps_what_is_finished_and_says_how_to_go_on(here):
    cache, before = str(here / "cache"), sweep_process.rows(here / "run")
    words = "sweep grid.yaml --methods baseline,cspace-sample --out run"
    process = start(here, words, HTCP_CACHE=cache)
    compiles(here)(process)
    process.send_signal(signal.SIGTERM)
    _, errors = process.communicate(timeout=LIMIT_S)
    go_on = "htcp: stopped; 6 of 12 plans are finished in run; run the same command to resume"
    assert (process.returncode, sweep_process.without_progress(errors)) == (143, [go_on])
    assert sweep_process.rows(here / "run") == before and open_run(here / "run").unfinished() == {"cspace-sample": 6}


def test_a_process_ends_with_its_code_while_a_thread_is_at_work():
    """Check the exit code with a running thread: the interpreter's own shutdown can abort C++ threads of libraries."""
    code = (
        "import atexit, threading, time\nfrom htcp_jax.system.process_exit import run\n"
        "atexit.register(print, 'closed')\nthreading.Thread(target=time.sleep, args=(600,)).start()\nrun(lambda: 3)"
    )
    done = subprocess.run([sys.executable, "-c", code], env=environment(), capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (3, "closed\n", "")


def test_a_command_leaves_what_another_one_is_writing_into_the_same_folder(tmp_path):
    code = "from htcp_jax.system import process_exit, unfinished; process_exit.run(lambda: unfinished.clear({!r}) or 0)"
    with temporary_folder(tmp_path) as scratch:
        write = scratch / f"{PART}file"
        write.write_text("")
        for folder in (tmp_path, scratch):
            subprocess.run([sys.executable, "-c", code.format(str(folder))], env=environment(), check=True)
        assert scratch.is_dir() and not write.exists()  # no process has locked the file


def test_without_memory_a_command_ends_with_one_line(here):
    command = f"ulimit -v 1000000; exec {sys.executable} -m htcp_jax {WORDS['plan']}"
    done = subprocess.run(["sh", "-c", command], cwd=here, env=environment(), capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (1, "") and not (here / "out").exists()
    limited = "the address space is limited to 1.0 GB; set ulimit -v to 1572864 or more"
    assert done.stderr == f"htcp: out of memory: {limited}\n"


def test_the_call_from_python_leaves_signal_handlers_as_they_are(capsys):
    numbers = signal.SIGINT, signal.SIGTERM
    before = [signal.getsignal(number) for number in numbers]
    assert main(["methods"]) == 0
    assert [signal.getsignal(number) for number in numbers] == before


def test_progress_without_a_terminal_is_a_line_now_and_then(capsys):
    with output.progress_bar("plans", line_s=0.01) as progress:
        progress(3, 1200)
        time.sleep(0.5)
    lines = capsys.readouterr().err.splitlines()
    assert lines and all(line.startswith("htcp: plans 3/1200 0:00:0") for line in lines)


def test_progress_says_what_comes_before_the_first_step(capsys):
    with output.progress_bar("targets", first="compiling; targets", line_s=0.05) as progress:
        time.sleep(0.3)
        progress(0, 21)
        time.sleep(0.3)
    lines = capsys.readouterr().err.splitlines()
    assert lines[0].startswith("htcp: compiling; targets 0/?") and lines[-1].startswith("htcp: targets 0/21")


def test_a_command_that_shows_nothing_else_says_that_it_is_at_work(capsys, monkeypatch):
    monkeypatch.setattr(heartbeat, "LINE_S", 0.1)
    with heartbeat.HEARTBEAT.command("view"):
        time.sleep(0.5)
        with output.progress_text("drawing"):
            time.sleep(0.5)
        time.sleep(0.5)
        heartbeat.HEARTBEAT.end()
        before = capsys.readouterr().err.splitlines()
        time.sleep(0.3)
    kinds = ["drawing" in line for line in before]
    assert all(line.startswith(("htcp: view: at work 0:00:0", "htcp: drawing 0:00:0")) for line in before)
    assert not kinds[0] and not kinds[-1] and any(kinds)
    assert kinds.index(True) + sum(kinds) <= len(kinds) - 1  # no line of the command while a bar is shown
    assert not capsys.readouterr().err


def test_the_progress_of_a_plan_counts_the_configurations_drawn_to_find_a_start():
    shown, most = [], 2048
    search = _Search(lambda *row: shown.append(row), recovers=True)
    for starts, drawn in ((None, 0), (0, 0), (0, 512), (1, 512)):
        search.update(batch.Progress(0, 1, 0, 21, starts, (drawn, most)))
    text = "; looking for a start: {} of 2,048 configurations"
    assert [row[2] for row in shown] == ["targets", *(f"targets{text.format(drawn)}" for drawn in (0, 512)), "targets"]


def test_the_progress_of_a_plan_names_a_target_that_is_searched_for_long(monkeypatch):
    shown, now = [], [0.0]
    monkeypatch.setattr("htcp_jax.cli.plan.time.monotonic", lambda: now[0])
    search = _Search(lambda *row: shown.append(row), recovers=True)
    hints = []
    for now[0], tracked in ((60.0, 0), (61.0, 7), (63.9, 7), (64.0, 7), (65.0, 8), (99.0, 21)):
        search.update(batch.Progress(0, 1, tracked, 21))
        hints.append("settings.effort=0" in search.stop_text)
    where = "targets; searching for a motion to target 7"
    texts = ["targets"] * 3 + [where] + ["targets"] * 2
    assert shown == [(tracked, 21, text) for tracked, text in zip((0, 7, 7, 7, 8, 21), texts, strict=True)]
    assert hints == [each[2] == where for each in shown]


def test_the_progress_of_seams_counts_plans_and_seams_and_names_no_target():
    shown = []
    search = _Search(lambda *row: shown.append(row), recovers=True)
    phase = "; 1 of 2 seams complete; seams from other configurations: 3 of 4 plans ended"
    search.update(batch.Progress(3, 4, 46, 80, phase=phase))
    search.update(batch.Progress(0, 1, 2, 3, phase=" of order 1", unit="air moves"))
    assert shown == [(46, 80, f"targets{phase}"), (2, 3, "air moves of order 1")]
    assert search.stop_text.startswith("stopped; 2 of 3 air moves of order 1; nothing is saved")


def test_the_progress_of_a_sweep_says_that_it_compiles_then_the_scenarios_done_and_the_time_left(capsys, monkeypatch):
    monkeypatch.setattr(heartbeat, "LINE_S", 0.05)
    with _sweep_bars() as show:
        for done, tracked, is_planning in ((0, 0, True), (3, 120, True), (6, 240, True), (6, 240, False)):
            show(SweepProgress("beam", done, 6, tracked, 240, is_planning=is_planning))
            time.sleep(0.3)
    lines = [line for line in capsys.readouterr().err.splitlines() if "scenarios" in line]
    assert lines[0].startswith("htcp: beam") and "loading and compiling; 0/6 scenarios" in lines[0]
    middle = next(line for line in lines if "3/6" in line)
    assert "compiling" not in middle and middle.endswith(" left") and lines[-1].endswith(" in all")
    assert any("verifying and saving; 6/6 scenarios" in line for line in lines) and "saving" not in lines[-1]


def served(process: subprocess.Popen) -> None:
    assert "http://" in process.stdout.readline()


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_viewer_that_serves_ends_as_other_commands_do(all_here, number):
    pytest.importorskip("viser", reason="the viewer is an extra")
    assert interrupt(all_here, WORDS["view"], served, number) == 128 + number


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("command", WORDS)
def test_a_signal_in_any_phase_of_any_command_is_one_line(all_here, command, number):
    """Send a signal at the start, while modules load, while programs are compiled, during work, and near the end."""
    began = time.monotonic()
    if command != "view":
        process = start(all_here, WORDS[command])
        process.communicate()
        assert process.returncode in CODES
        shutil.rmtree(all_here / "out", ignore_errors=True)
    took = time.monotonic() - began if command != "view" else 6.0
    waits = [lambda _, share=share: time.sleep(share * took) for share in (0.4, 0.7, 0.9, 1.0)]
    for phase in (handled, imports, *waits):
        interrupt(all_here, WORDS[command], phase, number)
        shutil.rmtree(all_here / "out", ignore_errors=True)  # left by a command that ended before the signal
    interrupt(all_here, WORDS[command], lambda _: time.sleep(1.5 * took), number, HTCP_CACHE=str(all_here / "cache"))


@pytest.mark.slow
@pytest.mark.parametrize("command", ["validate", "report", "gate"])
def test_commands_that_read_a_run_never_abort(all_here, command):
    """Regression: they aborted in 8 of 40 runs, after all output was written."""
    for _ in range(int(os.environ.get("HTCP_ENDS", "40"))):
        process = start(all_here, WORDS[command])
        _, errors = process.communicate()
        assert process.returncode == 0 and sweep_process.without_progress(errors) == []


def test_ctrl_c_before_the_handlers_are_installed_is_one_line_and_exit_130(here):
    code = "import os, signal, htcp_jax.__main__ as entry, htcp_jax.system as system\n"
    code += "system.run = lambda command: os.kill(os.getpid(), signal.SIGINT)\nentry.main()"
    environs = sweep_process.environment()
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environs, timeout=LIMIT_S)
    assert (done.returncode, done.stderr) == (130, "htcp: interrupted\n")

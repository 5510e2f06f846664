"""The wheel without the repository: its files, and every example of every help text, each text in an empty folder."""

import os
import re
import signal
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest
from documented import ROOT

from htcp_jax.caching import cache_folder
from htcp_jax.cli.main import COMMANDS

# Examples that would take longer than all other tests together are shortened.
PART = {
    "sweep sweeps/robot": "--limit 2",
    "sweep sweeps/cross": "--limit 2",
    "sweep sweeps/workpiece": "--limit 25",  # scenario 24 is the last
    "reachability sweeps/workpiece": "--limit 2",
    "place place/duct": "--scenarios 100",
}
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    """The wheel of this source."""
    folder = tmp_path_factory.mktemp("wheel")
    pip("wheel", "--no-deps", "--wheel-dir", folder, ROOT)
    (file,) = folder.glob("*.whl")
    return file


@pytest.fixture(scope="module")
def shell(wheel, tmp_path_factory) -> dict[str, str]:
    """Environment variables of a shell with the `htcp` of the wheel; its dependencies are those of the tests."""
    folder = tmp_path_factory.mktemp("environment")
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder], check=True)
    pip("--python", folder / "bin" / "python", "install", "--no-deps", wheel)
    (packages,) = folder.glob("lib/python*/site-packages")
    (packages / "tests.pth").write_text(sysconfig.get_path("purelib"))
    own = {"PATH": f"{folder / 'bin'}:{os.environ['PATH']}", "HOME": str(tmp_path_factory.mktemp("home"))}
    others = {"COLUMNS": "200", "HTCP_CACHE": str(cache_folder.enable() or "off")}
    return {name: value for name, value in os.environ.items() if name != "PYTHONPATH"} | own | others


def pip(*words: str | Path) -> None:
    subprocess.run([sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check", *words], check=True)


def run(line: str, shell: dict[str, str], folder: Path) -> str:
    """Output of a line typed into a shell, which must succeed. Ctrl-C ends `htcp view`, as soon as it serves."""
    if not line.startswith("htcp view") or "--help" in line:
        done = subprocess.run(["bash", "-c", f"{line}; exit"], env=shell, cwd=folder, capture_output=True, text=True)
        assert done.returncode == 0, f"{line}: {done.returncode}: {done.stdout}{done.stderr}"
        return done.stdout
    command, environment = ["bash", "-c", f"exec {line} --port 0"], shell | {"PYTHONUNBUFFERED": "1"}
    with subprocess.Popen(command, env=environment, cwd=folder, stdout=subprocess.PIPE, text=True) as process:
        assert "http://" in process.stdout.readline(), line
        process.send_signal(signal.SIGINT)
        output = process.stdout.read()
    assert process.returncode == 130, line
    return output


def examples(text: str) -> list[str]:
    """Commands of a help text: paragraphs of lines that begin with `htcp`, without headings and explanations."""
    found = []
    for paragraph in re.split(r"\n\s*\n", text):
        lines = [line.strip() for line in paragraph.strip().splitlines()]
        lines = lines[1:] if lines and lines[0].endswith(":") else lines
        if all(line.startswith("htcp ") for line in lines):
            found += [re.split(r"\s{2,}", line)[0] for line in lines]
    return found


def test_the_wheel_holds_every_file_of_the_package_and_all_examples(wheel):
    place = {"htcp_jax": "htcp_jax", "configs": "htcp_jax/examples/configs", "sweeps": "htcp_jax/examples/sweeps"}
    listed = subprocess.run(["git", "ls-files", *place], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    files = {re.sub(r"^\w+", lambda folder: place[folder[0]], name) for name in listed.split()}
    held = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}
    assert held == {name for name in files if not re.fullmatch("htcp_jax/examples/.*[.]py", name)}
    assert wheel.name.endswith("-py3-none-any.whl") and "htcp_jax/py.typed" in held


@pytest.mark.parametrize("command", ["", *COMMANDS])
def test_every_example_of_a_help_text_runs_with_the_wheel_in_an_empty_folder(shell, tmp_path, command):
    lines = examples(run(f"htcp {command} --help", shell, tmp_path))
    assert lines
    for line in lines:
        part = next((more for words, more in PART.items() if words in line and "--limit" not in line), "")
        for each in COMMANDS if "COMMAND" in line else [""]:
            run(f"{line.replace('COMMAND', each)} {part}", shell, tmp_path)


def test_the_package_runs_as_the_command(shell, tmp_path):
    assert run("python -m htcp_jax --version", shell, tmp_path) == run("htcp --version", shell, tmp_path)
    installed = run("python -c 'import htcp_jax; print(htcp_jax.__file__)'", shell, tmp_path)
    assert installed.startswith(shell["PATH"].split("/bin:")[0])

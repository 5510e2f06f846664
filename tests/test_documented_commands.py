"""Documented commands and Python blocks: each of them runs, in the way that `documented` lists."""

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
import tomllib

import pytest
from documented import (
    CI,
    COPY,
    FAILING,
    FILE,
    INSTALLED,
    NOT,
    QUICK,
    ROOT,
    SLOW,
    SUITE,
    TWO,
    WAYS,
    blocks,
    fences,
    in_sentences,
    indented_commands,
    pages,
    runs,
)

from htcp_jax.cli import main
from htcp_jax.jobs import load_config
from htcp_jax.planning import registry

DEMO_S = 180  # from a clone to a picture
DRY_RUN = "make", "--dry-run", f"PYTHON={sys.executable}"  # a Python named here is not looked for


def pages_with(how: str) -> list[str]:
    return [page for page in pages() if any(block.how == how for block in blocks(page))]


@pytest.fixture
def reader(tmp_path, monkeypatch):
    """Working folder of a reader: links to the shipped files; files that a page writes stay separate."""
    for name in ("configs", "sweeps", "tests", "htcp_jax", "pyproject.toml"):
        (tmp_path / name).symlink_to(ROOT / name)
    monkeypatch.chdir(tmp_path)
    known = registry.names()
    yield tmp_path
    for name in set(registry.names()).difference(known):
        registry.METHODS._own.pop(name)


def on_earlier_pages(page: str) -> set[str]:
    """Commands of quick blocks of the pages before this one, which run them as they stand."""
    earlier = pages()[: pages().index(page)]
    return {line for each in earlier for block in blocks(each) if block.how == QUICK for line in block.commands}


def follow(page: str, how: str) -> None:
    """Run the blocks of a page that are marked `how`, in order; quick commands once for all pages."""
    done = on_earlier_pages(page) if how == QUICK else set()
    for block in blocks(page):
        if block.how != how and not (how == SLOW and block.how in FAILING):
            continue
        if file := FILE.match(block.kind):
            with open(file["name"], "w", encoding="utf-8") as stream:
                stream.write(block.text)
        elif block.kind == "python":
            exec(compile(block.text, f"{page}, python block", "exec"), {"__name__": "__main__"})
        else:
            for command in block.commands:
                if command in done:
                    continue
                command += " --limit 2" * (how == TWO and not command.startswith("htcp report"))
                assert run(shlex.split(command)) == FAILING.get(block.how, 0), f"{page}: {command}"


def run(words: list[str]) -> int:
    """Run one command and return its exit code; `htcp` runs in this process and shares its compiled programs."""
    if words[:2] == ["htcp", "view"]:
        return serve(words)
    if words[0] == "htcp":
        try:
            return main(words[1:])
        except SystemExit as done:  # how --show-completion ends
            return done.code or 0
    if words[0] == ".venv/bin/python":
        return subprocess.run([sys.executable, *words[1:]], cwd=ROOT).returncode
    raise AssertionError(f"{shlex.join(words)}: no way to run it; mark its block with how it is run")


def serve(words: list[str]) -> int:
    """Start a server command, send Ctrl-C once it serves, and return 0 if that ends it with 130."""
    command = [sys.executable, "-u", "-m", "htcp_jax", *words[1:], "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert "http://" in process.stdout.readline()
        process.send_signal(signal.SIGINT)
        process.stdout.read()
    return process.returncode - 130


def test_every_command_has_a_way_to_be_run():
    for page in pages():
        assert not indented_commands(page), f"{page}: commands in an indented block; fence them"
        for block in blocks(page):
            assert block.how in WAYS, f"{page}: {block.how!r} is no way to run a block; valid: {', '.join(WAYS)}"
            if block.how == CI:
                ran = (ROOT / ".ci" / "run").read_text()
                for command in block.commands:
                    assert re.search(rf"^ *{command} VENV=", ran, re.MULTILINE), f"{page}: {command} is not in .ci/run"
            if block.how == SUITE:
                assert block.commands == ["make check", "make test-changed", "make test-slow"]
    assert {block.how for page in pages() for block in blocks(page)} == set(WAYS)


@pytest.mark.parametrize("page", pages())
def test_every_block_is_run_or_compared_or_has_a_reason(page, tmp_path):
    """YAML without a file name is part of a job: its keys exist, and its values have the right types."""
    run = blocks(page)
    for block in fences(page):
        if block in run or block.how == INSTALLED or NOT.fullmatch(block.how):
            continue
        if block.file:
            assert block.text == (ROOT / block.file).read_text(encoding="utf-8"), f"{page}: differs from {block.file}"
        elif block.kind == "yaml":
            job = tmp_path / "job.yaml"
            job.write_text(block.text, encoding="utf-8")
            load_config(job, {"robot.model": "gp50"})  # the arm of the block does not ship
        else:
            assert block.kind == "text" and not re.search(r"^\$ ", block.text, re.MULTILINE), (
                f"{page}: no test runs this {block.kind} block; mark it <!-- runs: not: REASON -->\n{block.text}"
            )


@pytest.mark.parametrize("page", pages())
def test_what_sentences_speak_of_is_there(page, capsys):
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    for command in in_sentences(page):
        program, *words = shlex.split(command)
        if program == "htcp" and words != ["--install-completion"]:
            assert main([*words, "--help"]) == 0, f"{page}: {command}"
        elif program == "make":
            known = subprocess.run([*DRY_RUN, *words], cwd=ROOT, capture_output=True, text=True)
            assert known.returncode == 0, f"{page}: {command}: {known.stderr}"
        elif program == ".venv/bin/pip":
            assert words[:2] == ["install", "-e"] and words[2][2:-1] in extras, f"{page}: {command}"


@pytest.mark.slow
@pytest.mark.parametrize("page", [page for page in pages() if any(map(runs, in_sentences(page)))])
def test_whole_commands_in_sentences_run(reader, page):
    for command in filter(runs, in_sentences(page)):
        assert run(shlex.split(command)) == 0, f"{page}: {command}"


@pytest.mark.parametrize("page", pages_with(QUICK))
def test_quick_blocks_run_as_they_stand(reader, page):
    follow(page, QUICK)


@pytest.mark.slow
@pytest.mark.parametrize("page", pages_with(SLOW))
def test_slow_blocks_run_as_they_stand(reader, page):
    follow(page, SLOW)


@pytest.mark.slow
@pytest.mark.parametrize("page", pages_with(TWO))
def test_the_longest_blocks_run_with_their_first_two_scenarios(reader, page):
    follow(page, TWO)


@pytest.mark.slow
@pytest.mark.parametrize("page", pages_with(COPY))
def test_a_newcomer_gets_from_a_clone_to_a_picture_in_three_minutes(tmp_path, page):
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for name in filter(None, listed.split("\0")):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(ROOT / name, tmp_path / name)
    kept = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VIRTUAL_ENV")}
    began = time.perf_counter()
    for block in blocks(page):
        for command in block.commands if block.how == COPY else ():
            environment = {**kept, "HTCP_CACHE": str(tmp_path / "cache")}
            assert subprocess.run(shlex.split(command), cwd=tmp_path, env=environment).returncode == 0, command
    print(f"{page}: {time.perf_counter() - began:.0f} s of {DEMO_S}")
    assert (tmp_path / "out" / "plan" / "plan.png").stat().st_size > 10_000

"""Usability of the command line: help with examples, completion, JSON output, colours on terminals only."""

import json
import re

import jax
import numpy as np
import pytest

from htcp_jax.caching import cache_folder, cache_key
from htcp_jax.cli import main, self_test
from htcp_jax.cli.main import app
from htcp_jax.cli.methods import complete_methods
from htcp_jax.device.executor import warn_if_unprepared
from htcp_jax.planning.registry import descriptions

SHORT = ["--set", "workpiece.path=path.csv", "--set", "method=baseline"]
COLOUR = re.compile(r"\x1b\[[0-9;]*(?:3[0-7]|9[0-7])[0-9;]*m")


@pytest.fixture
def here(tmp_path, monkeypatch):
    """Working folder with a path of two points and a sweep of two scenarios along it."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "path.csv").write_text("0.1857,-0.1737,0.1708\n0.19,-0.1738,0.1705\n")
    (tmp_path / "two.yaml").write_text("grid: [{workpiece.rotation_z_rad: [0.1, 0.2]}]")
    return tmp_path


def json_of(capsys, arguments: list[str], code: int = 0):
    """Output of a command with --json: one JSON document and nothing else."""
    assert main([*arguments, "--json"]) == code
    output = capsys.readouterr()
    assert output.err == ""
    return json.loads(output.out)


def test_every_command_has_help_with_an_example_of_itself(capsys):
    names = [command.callback.__name__ if command.name is None else command.name for command in app.registered_commands]
    for name in names:
        assert main([name, "--help"]) == 0
        shown = capsys.readouterr().out
        assert f"  htcp {name}" in shown
        assert "--json" in shown or name in ("view", "prepare")  # these print no table
    assert main(["--help"]) == 0
    shown = capsys.readouterr().out
    assert all(f"\n  {name}" in shown for name in names)
    assert "..." not in shown.split("Commands:")[1]  # no command's summary is truncated


def test_completion_offers_commands_options_and_methods(monkeypatch, capsys):
    def offered(words: str) -> list[str]:
        monkeypatch.setenv("_HTCP_COMPLETE", "complete_bash")
        monkeypatch.setenv("COMP_WORDS", words)
        monkeypatch.setenv("COMP_CWORD", str(words.count(" ")))
        with pytest.raises(SystemExit):
            main([])
        return capsys.readouterr().out.split()

    assert offered("htcp me") == ["methods"]
    assert offered("htcp plan --method nspace-s") == ["nspace-sample", "nspace-sqp"]
    assert offered("htcp sweep x.yaml --methods baseline,h") == ["baseline,hybrid"]
    assert "--json" in offered("htcp plan --j")
    assert complete_methods("baseline,base") == []


def test_completion_scripts_are_printed(capsys):
    with pytest.raises(SystemExit, match="0"):
        main(["--show-completion", "bash"])
    assert "complete -o default -F _htcp_completion htcp" in capsys.readouterr().out


def test_methods_are_listed_with_their_sentences(capsys):
    assert main(["methods"]) == 0
    shown = " ".join(capsys.readouterr().out.split())  # sentences are wrapped at the terminal's width
    assert all(name in shown and description in shown for name, (_, description) in descriptions().items())
    assert [row["method"] for row in json_of(capsys, ["methods"])] == list(descriptions())


def test_plan_prints_its_summary_as_json(here, capsys):
    reported = json_of(capsys, ["plan", *SHORT, "--out", "out"])
    assert reported == json.loads((here / "out" / "summary.json").read_text())
    assert reported["tracked"] == 13 and reported["config"]["method"] == "baseline"


def test_sweep_and_reachability_print_what_they_found_as_json(here, capsys):
    reported = json_of(capsys, ["sweep", "two.yaml", "--methods", "baseline", *SHORT[:2]])
    assert reported["complete"] and reported["methods"]["baseline"]["targets"] == 2 * 13
    found = json_of(capsys, ["reachability", "two.yaml", "--limit", "1", *SHORT[:2], "--out", "c"])
    assert found == json.loads((here / "c" / "reachability.json").read_text())


def test_the_doctor_tells_what_is_there(capsys, opengl, tmp_path):
    before = jax.config.jax_compilation_cache_dir
    self_test.self_test()  # what it needs is compiled then, and not written into the other cache
    (tmp_path / "program").write_bytes(b"12345")
    jax.config.update("jax_compilation_cache_dir", str(tmp_path))
    opengl("osmesa")
    try:
        found = json_of(capsys, ["doctor"])
        assert main(["doctor"]) == 0
        shown = capsys.readouterr().out
        cache_folder.write(cache_key.preparation_key(jax.devices()[0]), b"")
        assert json_of(capsys, ["doctor"])["cache"]["prepared"]
        warn_if_unprepared(6, 16, jax.devices()[0])
        with pytest.warns(UserWarning, match="with 6 joints, htcp prepare covers at most 16 bodies"):
            warn_if_unprepared(6, 24, jax.devices()[0])
    finally:
        jax.config.update("jax_compilation_cache_dir", before)
    assert found["sound"] and found["versions"]["jax"] == jax.__version__ and found["dtype"] == "float64"
    assert found["cores"]["usable"] >= 1 and found["devices"]
    assert found["rendering"] == {"platform": "osmesa", "lacks": None}
    assert found["cache"] == {"folder": str(tmp_path), "files": 1, "bytes": 5, "prepared": False}
    assert str(tmp_path) in shown and "htcp prepare compiles" in shown
    assert "from the known result" in shown and shown.endswith("sound\n")


def test_nothing_is_prepared_without_a_cache(capsys, monkeypatch):
    monkeypatch.setenv("HTCP_CACHE", "off")
    assert main(["prepare"]) == 2
    assert "set HTCP_CACHE to a folder" in capsys.readouterr().err


def test_a_machine_that_cannot_draw_is_sound_and_told_what_it_lacks(capsys, opengl):
    opengl()
    assert json_of(capsys, ["doctor"])["rendering"]["platform"] is None
    assert main(["doctor"]) == 0
    assert "install libegl1" in capsys.readouterr().out


def test_the_self_test_passes_here_and_fails_on_another_answer(capsys, monkeypatch):
    assert json_of(capsys, ["doctor"])["self_test"]["passed"]
    # No input changes the answer, and no installation at hand gives a wrong one.
    monkeypatch.setattr(self_test, "KNOWN_RAD", np.add(self_test.KNOWN_RAD, 1e-5))
    assert main(["doctor"]) == 1
    assert "the self-test failed" in capsys.readouterr().out


def test_colours_are_for_terminals_and_no_color_takes_them_away(capsys, monkeypatch):
    def shown(**environment: str) -> str:
        for name in ("NO_COLOR", "FORCE_COLOR"):
            monkeypatch.delenv(name, raising=False)
        for name, value in environment.items():
            monkeypatch.setenv(name, value)
        main(["methods"])
        return capsys.readouterr().out

    monkeypatch.setenv("TERM", "xterm-256color")
    assert COLOUR.search(shown(FORCE_COLOR="1"))
    assert not COLOUR.search(shown(FORCE_COLOR="1", NO_COLOR="1"))
    assert "\x1b" not in shown()  # piped

"""Tables on the terminal: within 80 columns, or within COLUMNS."""

import re

import pytest
from small_run import toy_run

from htcp_jax.cli import main
from htcp_jax.cli.output import print_table, stdout
from htcp_jax.report import Table
from htcp_jax.runs import Column

WIDE = Table(
    "wide",
    (Column("m", "method"), *(Column(f"n{k}", f"figure {k}", "of some", ".3f") for k in range(12)), Column("t", "of")),
    tuple((f"method {row}", *(row + k / 7 for k in range(12)), "joint6") for row in range(3)),
)


def printed(table: Table, capsys) -> list[str]:
    print_table(stdout(), table)
    return capsys.readouterr().out.splitlines()


def rows_of(text: str) -> list[str]:
    """Lines of tables: those with separated cells, except a line that names a file."""
    apart = (line for line in text.splitlines() if re.search(r"\S {2,}\S", line))
    return [line for line in apart if not line.startswith(("files", "report"))]


@pytest.mark.parametrize("command", ["sweep", "validate", "validate fast", "report", "gate", "methods"])
def test_every_table_of_the_command_line_fits_80_columns(request, tmp_path, monkeypatch, capsys, command):
    """Width of every table of the command line: at most 80 columns (regression: up to 138)."""
    monkeypatch.setenv("COLUMNS", "80")
    real = command.startswith("validate")  # the toy has no joint speeds, which have columns
    place = request.getfixturevalue("planned") if real else toy_run()
    run = str(place / "run")
    if command == "gate":
        assert main(["gate", run, "--baseline", str(tmp_path / "base.yaml"), "--update"]) == 0
        capsys.readouterr()
    words = {
        "sweep": ["sweep", str(place / "grid.yaml"), "--methods", "baseline,cspace-sample", "--out", run],
        "validate": ["validate", run, "--between", "2", "--verbose"],
        "validate fast": ["validate", run, "--between", "0", "--verbose"],
        "report": ["report", run, "--out", str(tmp_path / "report")],
        "gate": ["gate", run, "--baseline", str(tmp_path / "base.yaml")],
        "methods": ["methods"],
    }[command]
    assert main(words) == 0
    lines = rows_of(capsys.readouterr().out)
    assert len(lines) > 3
    assert not [line for line in lines if len(line) > 80]


@pytest.mark.parametrize("columns", [40, 80, 120, 300])
def test_a_wide_table_goes_on_below_with_its_first_column(monkeypatch, capsys, columns):
    monkeypatch.setenv("COLUMNS", str(columns))
    lines = printed(WIDE, capsys)
    assert max(map(len, lines)) <= columns
    text = "\n".join(lines)
    for k in range(12):
        assert text.count(f"figure {k} ") + text.count(f"figure {k}\n") >= 1
    parts = text.split("\n\n")
    assert (len(parts) == 1) == (columns == 300)
    assert all(part.splitlines()[2].startswith("method 0") for part in parts)


def test_columns_that_belong_together_stay_together(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "80")
    last = "\n".join(printed(WIDE, capsys)).split("\n\n")[-1].splitlines()
    assert "figure 11" in last[0] and last[0].endswith("of")


def test_a_pipe_has_80_columns(monkeypatch, capsys):
    monkeypatch.delenv("COLUMNS", raising=False)
    assert max(map(len, printed(WIDE, capsys))) <= 80


def test_a_long_last_text_is_wrapped_next_to_its_row(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "60")
    rows = (("a", "word " * 30), ("b", "short"))
    lines = printed(Table("t", (Column("m", "method"), Column("s", "sentence")), rows), capsys)
    assert max(map(len, lines)) <= 60
    assert [line.split()[0] for line in lines if line[0] != " "] == ["method", "a", "b"]
    assert " ".join(lines).split().count("word") == 30

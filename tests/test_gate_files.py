"""Gate output for CI: JUnit XML as read by junitparser, Markdown as read by markdown-it, GitHub annotations."""

import json
import resource
import shutil
import urllib.parse

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from junitparser import Failure, JUnitXml, Skipped
from markdown_it import MarkdownIt
from small_run import end_early, toy_run

from htcp_jax.cli import main
from htcp_jax.errors import InputError
from htcp_jax.markup import printable
from htcp_jax.report import Table
from htcp_jax.report.document import markdown
from htcp_jax.report.gate import annotations, gate_summary, junit
from htcp_jax.runs import Column, open_run
from htcp_jax.runs.manifest import MANIFEST
from htcp_jax.status import Status
from htcp_jax.system.output_files import append_text
from htcp_jax.validation import read_baseline
from htcp_jax.validation.gate import CHECKS, compare

PASSED, REGRESSION, BAD_INPUT = 0, 1, 2
HOSTILE = "a|b\\|c <b>&amp;</b> `d` *e* _f_ ~g~ $h$ [i](j) ::error::%0A, \x07\udcff\nk"
READER = MarkdownIt("commonmark").enable(["table", "strikethrough"])


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """Folder with the toy's run, its baseline, and a worse run: two scenarios end earlier, one by a single target."""
    place = tmp_path_factory.mktemp("gate")
    run, worse = (shutil.copytree(toy_run() / "run", place / name) for name in ("run", "worse"))
    end_early(worse, 2, 4, Status.QP_INFEASIBLE)
    end_early(worse, 1, 7, Status.ITERATION_LIMIT, "cspace-sample")
    assert main(["gate", str(run), "--baseline", str(place / "baseline.yaml"), "--update"]) == PASSED
    return place


@pytest.fixture(scope="module")
def verdict(place):
    return compare(open_run(place / "worse"), read_baseline(place / "baseline.yaml"))


@pytest.fixture(autouse=True)
def no_actions(monkeypatch):
    """Unset GITHUB_ACTIONS, as the tests may run on GitHub Actions themselves."""
    monkeypatch.delenv("GITHUB_ACTIONS", raising=False)


def gate(place, run, *options) -> int:
    return main(["gate", str(place / run), "--baseline", str(place / "baseline.yaml"), *map(str, options)])


def texts(markdown_text: str) -> list[str]:
    """Contents of all cells, paragraphs and headings; anything but plain text becomes `?`."""
    tokens = READER.parse(markdown_text)
    assert "html_block" not in {token.type for token in tokens}
    shown = {"text": str, "strong_open": lambda _: "", "strong_close": lambda _: ""}
    inline = (token.children for token in tokens if token.type == "inline")
    return ["".join(shown.get(child.type, lambda _: "?")(child.content) for child in children) for children in inline]


def cases(text: str) -> dict[tuple[str, str], list]:
    (suite,) = JUnitXml.fromstring(text.encode())
    return {(case.classname, case.name): case.result for case in suite}


def test_the_junit_file_has_one_test_case_per_method_and_check(place, tmp_path):
    assert gate(place, "worse", "--junit", tmp_path / "gate.xml") == REGRESSION
    read = JUnitXml.fromfile(str(tmp_path / "gate.xml"))
    found = cases((tmp_path / "gate.xml").read_text())
    methods = "grid.baseline", "grid.cspace-sample"
    assert list(found) == [("grid.run", "files"), *((method, check) for method in methods for check in CHECKS)]
    assert (read.tests, read.failures, read.errors) == (19, 6, 0)
    failed = {case: result[0].message for case, result in found.items() if result and isinstance(result[0], Failure)}
    assert failed["grid.cspace-sample", "tracked targets"] == "1 target fewer tracked, 31 of 32; allowed decrease: 0"
    assert failed["grid.baseline", "scenarios ending earlier"] == "1 scenario ended earlier; allowed: 0"
    assert isinstance(found["grid.baseline", "times"][0], Skipped)


def test_a_failed_test_case_names_the_scenarios(verdict):
    (failure,) = cases(junit(verdict))["grid.baseline", "scenarios ending earlier"]
    label = "baseline, scenario 2 (rotation y 0 rad, tool extension 0.01 m)"
    assert f"{label}: the first difference is at target 4" in failure.text


def test_the_markdown_has_method_before_now_difference_and_the_scenarios_that_changed(place, tmp_path):
    assert gate(place, "worse", "--markdown", tmp_path / "gate.md") == REGRESSION
    found = texts((tmp_path / "gate.md").read_text())
    head = found.index("method")
    assert found[head : head + 5] == ["method", "verdict", "tracked [before]", "tracked [now]", "difference"]
    assert found[head + 8 : head + 13] == ["baseline", "FAILED", "32", "28", "-4"]
    scenario = found.index("2 (rotation y 0 rad, tool extension 0.01 m)")
    assert found[scenario - 1 : scenario + 6] == [
        *("baseline", "2 (rotation y 0 rad, tool extension 0.01 m)", "8", "4", "-4", "4", Status.QP_INFEASIBLE.message)
    ]


def test_figures_that_changed_are_listed_with_their_difference(verdict):
    first, *others = verdict.rows
    row = first._replace(was_clearance_min_mm=2.0, clearance_min_mm=0.5, was_held=3, held=None)
    found = texts(gate_summary(verdict._replace(rows=(row, *others))))
    place = found.index("clearance [min mm]")
    assert found[place - 1 : place + 4] == ["baseline", "clearance [min mm]", "2", "0.5", "-1.5"]
    place = found.index("feed held [scenarios]")
    assert found[place + 1 : place + 4] == ["3", "-", "-"]


def test_every_output_names_the_commit_and_the_versions_of_baseline_and_run(place, tmp_path, capsys):
    def other(manifest):
        manifest["planned_by"][0].update(commit="0123456789abcdef+changes")
        manifest["planned_by"][0]["versions"].update(jax="9.8.7")

    run = shutil.copytree(place / "run", tmp_path / "run")
    manifest = json.loads((run / MANIFEST).read_text())
    was = manifest["planned_by"][0]["commit"]
    other(manifest)
    (run / MANIFEST).write_text(json.dumps(manifest))
    files = ["--junit", tmp_path / "gate.xml", "--markdown", tmp_path / "gate.md"]
    assert gate(place, run, *files) == PASSED
    terminal = capsys.readouterr().out
    assert gate(place, run, "--json") == PASSED
    for text in (terminal, *(file.read_text() for file in files[1::2]), capsys.readouterr().out):
        assert was[:12] in text and "0123456789ab" in text and "+changes" in text
        assert "9.8.7" in text and read_baseline(place / "baseline.yaml").versions["jax"] in text


def test_a_second_verdict_follows_in_the_markdown_and_replaces_the_junit_file(place, tmp_path):
    summary_file, junit_file = tmp_path / "summary.md", tmp_path / "gate.xml"
    summary_file.write_text("a step's own line")
    assert gate(place, "worse", "--markdown", summary_file, "--junit", junit_file) == REGRESSION
    assert gate(place, "run", "--markdown", summary_file, "--junit", junit_file) == PASSED
    headings = [text for text in texts(summary_file.read_text()) if text.startswith(("a step's", "htcp gate"))]
    assert headings == ["a step's own line", "htcp gate: grid FAILED", "htcp gate: grid passed"]
    assert JUnitXml.fromfile(str(junit_file)).failures == 0


def test_a_run_that_cannot_be_read_is_in_the_files_too(place, tmp_path):
    run = shutil.copytree(place / "run", tmp_path / "run")
    (run / MANIFEST).write_text("{")
    files = tmp_path / "new" / "gate.xml", tmp_path / "new" / "gate.md"
    assert gate(place, run, "--junit", files[0], "--markdown", files[1]) == REGRESSION
    found = cases(files[0].read_text())
    assert "manifest.json is damaged" in found["grid.run", "files"][0].message
    assert found["grid.baseline", "scenarios present"][0].message == "missing"
    assert "manifest.json is damaged" in files[1].read_text()


def test_names_survive_whatever_is_in_them(verdict):
    changed = tuple(one._replace(label=HOSTILE) for one in verdict.changed)
    checks = tuple(check._replace(failures=(HOSTILE,) * bool(check.failures)) for check in verdict.checks)
    hostile = verdict._replace(sweep=HOSTILE, changed=changed, checks=checks)
    hostile = hostile._replace(failures=(HOSTILE,), improvements=(HOSTILE,))
    line = printable(HOSTILE).replace("\n", " ")
    found = texts(gate_summary(hostile))
    assert f"htcp gate: {line} FAILED" in found and found.count(line) == 4
    (suite,) = JUnitXml.fromstring(junit(hostile).encode())
    assert suite.name == printable(HOSTILE)
    assert {case.result[0].message for case in suite if case.result} >= {printable(HOSTILE)}


@example(HOSTILE)
@example("\\")
@given(st.text())
def test_any_text_reads_from_a_table_of_markdown_as_it_was(text):
    found = texts(markdown([Table("t", (Column("a", "head"),), ((text,), ("end",)))]))
    assert found == ["head", " ".join(printable(text).splitlines()).strip(), "end"]


def test_a_method_that_fails_is_an_annotation_on_github_actions_alone(place, capsys, monkeypatch):
    assert gate(place, "worse") == REGRESSION
    assert "::error" not in capsys.readouterr().out
    monkeypatch.setenv("GITHUB_ACTIONS", "true")
    assert gate(place, "worse") == REGRESSION
    reported = [line for line in capsys.readouterr().out.splitlines() if line.startswith("::")]
    assert reported == [
        "::error title=htcp gate grid%3A baseline"
        "::4 targets fewer tracked, 28 of 32; allowed decrease: 0%0A"
        "4 targets fewer executable, 28 of 32; allowed decrease: 0%0A1 scenario ended earlier; allowed: 0",
        "::error title=htcp gate grid%3A cspace-sample"
        "::1 target fewer tracked, 31 of 32; allowed decrease: 0%0A"
        "1 target fewer executable, 31 of 32; allowed decrease: 0%0A1 scenario ended earlier; allowed: 0",
    ]


def test_annotations_leave_json_on_stdout_alone(place, capsys, monkeypatch):
    monkeypatch.setenv("GITHUB_ACTIONS", "true")
    assert gate(place, "worse", "--json") == REGRESSION
    output = capsys.readouterr()
    assert json.loads(output.out)["checks"][0]["name"] == "files" and output.err.count("::error title=") == 2


@example(HOSTILE)
@given(st.text())
def test_an_annotation_is_one_line_that_holds_any_text(verdict, text):
    check = verdict.checks[0]._replace(failures=(text,))
    (line,) = annotations(verdict._replace(sweep=text, checks=(check,)))
    assert not {"\n", "\r"} & set(line)
    command, title, message = line.removeprefix("::").split("::", 1)[0], *line.removeprefix("::").split("::", 1)
    assert command == title and urllib.parse.unquote(message) == printable(text)
    assert urllib.parse.unquote(title) == f"error title=htcp gate {printable(text)}: run"
    assert not {":", ","} & set(title)


@pytest.mark.parametrize(
    ("options", "line"),
    [
        (["--junit", "folder"], "cannot write to folder: Is a directory"),
        (["--junit", "gate.xml", "--markdown", "/dev/null"], "cannot write to /dev/null: not a regular file"),
        (["--markdown", ""], "--markdown is empty; give a value, or omit it"),
        (["--junit", "gate.xml", "--markdown", "baseline.yaml/gate.md"], "cannot write to baseline.yaml: "),
        (["--markdown", "gate.md", "--junit", f"new/{'x' * 300}"], "File name too long"),
        (["--junit", "gate.xml", "--markdown", "./gate.xml"], "gate.xml is named twice"),
        (["--markdown", "baseline.yaml"], "baseline.yaml is named twice"),
        (["--junit", "gate.xml", "--update"], "--update writes no comparison to gate.xml; omit"),
    ],
)
def test_a_report_file_that_cannot_be_written_is_one_line_and_exit_2(
    place, tmp_path, capsys, monkeypatch, options, line
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder").mkdir()
    shutil.copy(place / "baseline.yaml", tmp_path)
    assert main(["gate", str(place / "worse"), "--baseline", "baseline.yaml", *options]) == BAD_INPUT
    output = capsys.readouterr()
    assert line in output.err and output.err.count("\n") == 1 and output.out == ""
    assert {file.name for file in tmp_path.iterdir()} == {"folder", "baseline.yaml"}
    assert (tmp_path / "baseline.yaml").read_bytes() == (place / "baseline.yaml").read_bytes()


@pytest.mark.parametrize("there", [None, "", "before\n"])
def test_a_text_that_finds_no_room_leaves_the_file_as_it_was(tmp_path, there):
    file = tmp_path / "summary.md"
    if there is not None:
        file.write_text(there)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, limits[1]))
    try:
        with pytest.raises(InputError, match="File too large"):
            append_text(file, "x" * 2000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert (file.read_text() if file.exists() else None) == there

"""`python -m benchmarks gpu`: a trial on the CPU with two trees, and the inputs that it rejects."""

import sys

import jax
import pytest

from benchmarks import gpu


@pytest.fixture
def ran(monkeypatch, capsys):
    """Run the command; return its exit code and the lines that it printed, errors last."""

    def run(*words):
        monkeypatch.setattr(sys, "argv", ["gpu", *map(str, words)])
        code = gpu.main()
        printed = capsys.readouterr()
        return code, (printed.out + printed.err).splitlines()

    return run


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="it would measure")
def test_without_a_gpu_the_command_says_so(ran):
    assert ran() == (2, ["JAX finds no GPU here; --device cpu runs a trial on the CPU"])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--methods", "beam,baselin"], "--methods baselin: not in these sweeps; valid: baseline, "),
        (["--runs", "0"], "--runs 0: at least 1"),
        (["--scenarios", "-1"], "--scenarios -1: at least 1"),
        (
            ["--device", "cpu", "--against", "no-such"],
            "--against no-such: no such revision; pass --against REVISION or",
        ),
        (["--device", "cpu", "--trees", "old", "b=."], "old=: no tree of this project; --trees takes COMMIT=OLD"),
        (["--device", "cpu", "--trees", "a=.", f"b={gpu.ROOT}/docs"], f"b={gpu.ROOT}/docs: no tree of this project"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(ran, monkeypatch, words, message):
    monkeypatch.chdir(gpu.ROOT)
    code, lines = ran(*words)
    assert code == 2 and len(lines) == 1 and lines[0].startswith(message)


@pytest.mark.slow
def test_a_trial_counts_the_same_targets_in_two_equal_trees_and_goes_on_with_its_caches(ran, tmp_path):
    file = tmp_path / "gpu.json"
    few = "--device", "cpu", "--scenarios", "2", "--methods", "baseline", "--runs", "1"
    trees = "--trees", f"one={gpu.ROOT}", f"two={gpu.ROOT}", "--work", tmp_path / "work", "--record", file
    for count, cache in enumerate(("empty", "full")):
        code, lines = ran(*few, *trees)
        assert code == 0 and lines[-1] == f"recorded in {file}", lines
        record = gpu.loaded(file)
        assert (record["device"], record["here"], record["digest"]) == ("cpu", "two", gpu.digest(gpu.ROOT))
        here, against = (record["sweeps"]["baseline"][side]["runs"] for side in ("here", "against"))
        assert len(here) == len(against) == count + 1 and here[-1]["cache"] == against[-1]["cache"] == cache
        assert here[-1]["tracked"] == against[-1]["tracked"] and here[-1]["tracked"]["baseline"] > 0
    assert gpu.rows(record) == []

"""Count of the programs that are compiled, as progress shows it."""

import pytest

from htcp_jax.cli import output
from htcp_jax.device import compilations
from htcp_jax.device.compilations import Compilations


def test_the_text_counts_programs_and_estimates_the_time(monkeypatch):
    count, now = Compilations(), [0.0]
    monkeypatch.setattr(compilations.time, "monotonic", lambda: now[0])
    assert count.text == ""
    with count.requested(3) as begin:
        begin()
        with count.compiling():
            assert count.text == "compiling 1 of 3 programs, about 30 s"
            now[0] = 8.0
        assert count.text == ""  # nothing is compiled now
        begin()
        with count.compiling():
            now[0] = 10.0
            assert count.text == "compiling 2 of 3 programs, about 16 s"
            with count.compiling():  # at the same time, and not requested before
                assert count.text == "compiling 2 of 4 programs, about 12 s"
            now[0] = 38.0
            assert count.text == "compiling 3 of 4 programs, about 21 s"
        begin()  # was loaded
    with count.compiling():
        assert count.text.startswith("compiling 4 of 4 programs")


def test_a_request_that_fails_or_is_cancelled_is_not_counted_any_more():
    count = Compilations()
    with pytest.raises(KeyboardInterrupt), count.requested(5) as begin:
        begin()
        with count.compiling():
            raise KeyboardInterrupt
    with count.compiling():
        assert count.text.startswith("compiling 2 of 2 programs")


def test_while_more_programs_will_be_requested_the_text_has_their_least_number_and_no_time():
    count = Compilations()
    with count.requested(3) as begin:
        with count.growing(), count.compiling():
            begin()
            assert count.text == "compiling 1 of at least 3 programs"
        begin()
        with count.growing(), count.compiling():
            assert count.text == "compiling 2 of at least 3 programs"
        with count.compiling():
            assert count.text.startswith("compiling 3 of 4 programs, about ")


def test_a_progress_line_says_what_is_compiled_and_ends_with_the_elapsed_time(capsys, monkeypatch):
    count = Compilations()
    monkeypatch.setattr(output, "COMPILATIONS", count)
    with output.progress_bar("targets", line_s=0.02), count.requested(2) as begin, count.compiling():
        begin()
        while not (lines := capsys.readouterr().err.splitlines()):
            pass
    assert lines[0] == "htcp: targets 0/? compiling 1 of 2 programs, about 20 s 0:00:00"

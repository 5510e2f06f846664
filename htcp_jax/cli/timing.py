"""Timing of a run's scenarios and output of the times, for `htcp sweep --feed` and `htcp program --all`."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from rich.text import Text

from htcp_jax.cli.output import print_table, progress_bars, stdout
from htcp_jax.errors import InputError
from htcp_jax.io.robots import JointLimits
from htcp_jax.jobs import Sweep
from htcp_jax.report import timing_table as timings
from htcp_jax.runs import Run, timing_file
from htcp_jax.spec import feed as feed_rates
from htcp_jax.trajectory import check_limits, time_run


def timed(
    run: Run,
    feed: str | None,
    methods: Sequence[str] | None,
    overrides: Sequence[str] = (),
    stated: JointLimits | None = None,
) -> Run:
    """Time the motions of a run, and return the run with its times. Show one progress bar per method.

    Args:
        run: The run.
        feed: The feed rate, such as 20mm/s; None: the job's.
        methods: The methods to time; None: all methods with results.
        overrides: Changes to the job's section `program`, each "key=value".
        stated: Limits in a file, whose ranges all motions must satisfy; None: no file.

    Raises:
        InputError: See `time_run`.
    """
    with _timing_bars() as progress:
        return time_run(run, feed, methods, overrides=overrides, stated=stated, progress=progress, workers=None)


@contextmanager
def _timing_bars() -> Iterator[Callable[[str, int, int], None]]:
    with progress_bars() as bars:
        tasks: dict[str, int] = {}

        def show(method: str, done: int, of: int) -> None:
            if method not in tasks:
                tasks[method] = bars.add_task(f"times of {method}", total=of)
            bars.update(tasks[method], completed=done, total=of)

        yield show


def check_feed(spec: Sweep, feed: str) -> None:
    """Check that a sweep can be timed.

    Raises:
        InputError: If the feed rate is invalid, or if an arm of the sweep has no velocity limits.
    """
    feed_rates.feed_of(feed)
    check_limits(point.config for point in spec.points())


def timing_records(run: Run, methods: Sequence[str]) -> dict[str, dict]:
    """Return a summary of each method's times by method, for --json; methods without times are omitted."""
    known = _known_times(run, methods)
    return {
        method: {"feed_m_s": timing.feed_m_s, "limits": timing.limits} | timings.timing_row(method, timing.rows)
        for method, timing in known.items()
    }


def print_timing(run: Run, methods: Sequence[str]) -> None:
    """Print a table of each method's times, and the feed rate and limits."""
    known = _known_times(run, methods)
    if not known:
        return
    rows = [timings.timing_row(method, timing.rows) for method, timing in known.items()]
    print_table(stdout(), timings.timing_table(rows))
    stdout().print()
    for words in dict.fromkeys(timing.words for timing in known.values()):
        stdout().print(Text(f"Timed at {words}. {timings.MEANING}", style="dim"))


def refuse_untimed(run: Run, methods: Sequence[str]) -> None:
    """Check that at least one scenario has been timed.

    Raises:
        InputError: If no scenario has been timed.
    """
    if not any(len(timing.timed) for timing in _known_times(run, methods).values()):
        what = f"no motion by {', '.join(methods)} leads to the last target of a scenario"
        raise InputError(f"{run.folder}: {what}, so there is nothing to time")


def _known_times(run: Run, methods: Sequence[str]) -> dict[str, timing_file.Timing]:
    """Return the times of each method that has been timed, by method."""
    return {method: timing for method in methods if (timing := run.timing(method)) is not None}

"""`htcp render`: a picture and a movie of one plan, without a screen."""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import typer
from PIL import Image

from htcp_jax.cli.methods import complete_method
from htcp_jax.cli.output import Json, print_facts, print_json, progress_bars
from htcp_jax.errors import InputError
from htcp_jax.runs.plan_folder import written_whole
from htcp_jax.viewer import offscreen
from htcp_jax.viewer.movie import KINDS, check_kind, write_movie
from htcp_jax.viewer.playback import way
from htcp_jax.viewer.render import Studio
from htcp_jax.viewer.replay import Replay, open_replays

LEAST, MOST = 160, 3840  # pixels across
ASPECT = 11 / 16

Run = Annotated[Path, typer.Argument(metavar="RUN", help="The folder that htcp sweep or htcp plan wrote.")]
Scenario = Annotated[int, typer.Option(metavar="K", help="Its number, as in the tables; a plan has only 0.")]
Method = Annotated[
    str | None, typer.Option(metavar="NAME", help="By default the run's first.", autocompletion=complete_method)
]
Target = Annotated[
    int | None, typer.Option(metavar="T", help="Where the arm is in the picture; by default the last tracked.")
]
Movie = Annotated[str, typer.Option(metavar="KIND", help=f"One of {', '.join(KINDS)}, none.")]
Close = Annotated[bool, typer.Option("--close", help="Look at the workpiece, not at the whole arm.")]
Width = Annotated[int, typer.Option(metavar="PIXELS", help="Of the picture; the movie has half of it.")]
Out = Annotated[Path, typer.Option(metavar="DIR", help="Where the files go.")]


def render(
    run: Run,
    scenario: Scenario = 0,
    method: Method = None,
    target: Target = None,
    movie: Movie = "gif",
    close: Close = False,
    width: Width = 1280,
    out: Out = Path("out/render"),
    as_json: Json = False,
) -> int:
    """Draw one plan by MuJoCo, without a screen: a picture, and a movie along the targets.

    The workpiece is cut open. Targets are blue where they are tracked, orange after an escape, red where the plan
    failed, grey beyond; a green cube is a target at which the arm changes its posture, a purple ball the place where
    the least clearance is proven. Needs EGL or OSMesa of the system. Exits with 2 on bad input, and where both are
    missing.

    \b
    htcp render out/plan                                         the plan of htcp plan
    htcp render out/workpiece --scenario 24 --method nspace-sqp  one of a sweep
    htcp render out/plan --movie mp4 --close --width 1920        needs the extra "movie"
    """
    if movie != "none":
        check_kind(movie)
    if not LEAST <= width <= MOST:
        raise InputError(f"--width is {width}; from {LEAST} to {MOST} pixels are possible")
    offscreen.platform()  # before anything is read
    replays = open_replays(run)
    replay = replays.replay(scenario, method or replays.methods[0])
    last = len(replay.target) - 1
    if target is not None and not 0 <= target <= last:
        raise InputError(f"scenario {scenario} has no target {target}; it has 0 to {last}")
    shown = max(replay.tracked - 1, 0) if target is None else target
    name = f"scenario-{scenario}-{replay.method}"
    files = [f"{name}.png", *([f"{name}.{movie}"] if movie != "none" else [])]
    with written_whole(out) as folder:
        with Studio(replay, width, _height(width), close) as studio:
            Image.fromarray(studio.still(shown)).save(folder / files[0], optimize=True)
        for file in files[1:]:
            half = 2 * (width // 4)
            with Studio(replay, half, _height(half), close, fine=False) as studio:
                write_movie(folder / file, _frames(studio, replay))
    _print(replay, shown, [str(out / file) for file in files], as_json)
    return 0


def _height(width: int) -> int:
    return 2 * round(width * ASPECT / 2)


def _frames(studio: Studio, replay: Replay) -> Iterator:
    """The frames, with a bar on a terminal."""
    with progress_bars() as bars:
        yield from bars.track(studio.movie(), total=len(way(replay)) + 1, description="frames")


def _print(replay: Replay, shown: int, files: list[str], as_json: bool) -> None:
    tracked = f"{replay.tracked} of {len(replay.target)}"
    if as_json:
        record = {"scenario": replay.number, "method": replay.method, "tracked": replay.tracked}
        record |= {"targets": len(replay.target), "failed": replay.failed, "shown": shown}
        print_json({**record, "motion": replay.summary.record(), "files": files})
        return
    facts = {"targets tracked": tracked, **replay.summary.facts(), "the arm is at": f"target {shown}"}
    if replay.failed is not None:
        facts["failed at"] = f"target {replay.failed}"
    if replay.obstruction is not None:
        facts["in the way"] = replay.obstruction.description
    print_facts(f"{replay.method}, scenario {replay.label}", facts | {"files": ", ".join(files)})

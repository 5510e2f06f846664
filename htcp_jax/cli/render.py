"""`htcp render`: draw a picture and a movie of one plan, without a screen."""

from pathlib import Path
from typing import Annotated, NamedTuple

import typer
from PIL import Image

from htcp_jax import viewer
from htcp_jax.cli.feed import OneWay, PlayedFeed, ProgramKeys, played_feed
from htcp_jax.cli.methods import RunMethod
from htcp_jax.cli.output import Json, print_facts, print_json, progress_bar
from htcp_jax.errors import InputError
from htcp_jax.runs import open_plans
from htcp_jax.system import output_files
from htcp_jax.trajectory import PlanProgram, program_of
from htcp_jax.viewer import Replay, Studio, arms_of, frame_times, offscreen, recorded_replays, sample_program
from htcp_jax.viewer import movie as movies

LEAST, MOST = 160, 3840  # valid widths of a picture [pixels]
ASPECT = 11 / 16
SLOWEST, FASTEST = 0.1, 100.0

Run = Annotated[Path, typer.Argument(metavar="RUN", help="Output folder of htcp plan or htcp sweep.")]
Scenario = Annotated[int, typer.Option(metavar="K", help="Number of the scenario in the sweep.")]
Target = Annotated[
    int | None, typer.Option(metavar="T", help="Target at which the arm is drawn; by default the last tracked one.")
]
Movie = Annotated[
    str | None,
    typer.Option(metavar="KIND", help=f"Kind of movie: {', '.join(movies.KINDS)}, none; by default {movies.KINDS[0]}."),
]
Speed = Annotated[float | None, typer.Option(metavar="X", help="Playback speed with --feed; by default 1 (real time).")]
Close = Annotated[bool, typer.Option("--close", help="Show the workpiece close up instead of the complete arm.")]
FromPart = Annotated[
    bool, typer.Option("--from-part", help="Draw a moving part at rest and cut open; the cell moves around it.")
]
Width = Annotated[int, typer.Option(metavar="PIXELS", help="Width of the picture; the movie has half of it.")]
Out = Annotated[Path, typer.Option(metavar="DIR", help="Output folder, or only one file such as weld.mp4 or arm.png.")]


class _Files(NamedTuple):
    """Names of the files to write, and their folder. A name is None if that file is not written."""

    folder: Path
    picture: str | None
    movie: str | None

    @property
    def names(self) -> list[str]:
        return [str(self.folder / name) for name in (self.picture, self.movie) if name]


def render(
    run: Run,
    scenario: Scenario = 0,
    method: RunMethod = None,
    target: Target = None,
    movie: Movie = None,
    close: Close = False,
    from_part: FromPart = False,
    width: Width = 1280,
    out: Out = Path("out/render"),
    feed: PlayedFeed = None,
    speed: Speed = None,
    one_way: OneWay = False,
    overrides: ProgramKeys = None,
    as_json: Json = False,
) -> int:
    """Draw a picture and a movie of one plan; no screen is needed.

    A part that is a mesh is drawn as its own triangles, a cloud as discs, cut open where its walls would hide the path.
    The camera looks from the side from which least of the path is hidden. Targets are blue if tracked, orange if
    tracked after a recovery, red if the plan failed there, grey after that target. A green cube marks a target at which
    the arm changes its configuration, a purple ball the minimum guaranteed clearance. With --feed the movie shows the
    timed motion of htcp program, with plots of TCP and joint speeds. A part that moves is drawn complete, and the world
    is at rest; with --from-part the part is at rest and cut open. Install EGL or OSMesa.

    Exit codes: 0, 2 on bad input or without EGL and OSMesa.

    \b
    Examples:
      htcp plan
      htcp render out/plan                                         the plan of htcp plan
      htcp render out/plan --movie mp4 --close --width 1920        needs the extra "movie"
      htcp render out/plan --feed 200mm/s --out weld.mp4           only the movie, in real time
      htcp render out/plan --out arm.png                           only the picture
      htcp sweep sweeps/workpiece --methods baseline,nspace-sqp
      htcp render out/workpiece --scenario 24 --method nspace-sqp  one plan of a sweep
    """
    if movie not in (None, "none"):
        movies.check_kind(movie)
    feed_m_s = played_feed(feed, speed=speed is not None, one_way=one_way, set=overrides)
    if speed is not None and not SLOWEST <= speed <= FASTEST:
        raise InputError(f"--speed is {speed:g}; valid: {SLOWEST:g} to {FASTEST:g}")
    if feed_m_s is not None and (movie == "none" or _is_picture(out)):
        no_movie = f"--out {out}" if _is_picture(out) else "--movie none"
        raise InputError(f"--feed applies to the movie, but {no_movie} writes no movie; omit one of them")
    if not LEAST <= width <= MOST:
        raise InputError(f"--width is {width}; valid: {LEAST} to {MOST} pixels")
    offscreen.platform()  # raises an error before files are read
    found = open_plans(run)
    replays = recorded_replays(found)
    replay = replays.replay(scenario, method or replays.methods[0])
    last = len(replay.target) - 1
    if target is not None and not 0 <= target <= last:
        raise InputError(f"scenario {scenario} has no target {target}; it has 0 to {last}")
    shown = max(replay.tracked - 1, 0) if target is None else target
    made = None
    if feed_m_s is not None:
        made = program_of(found, feed_m_s, replay.method, scenario, retract=not one_way, overrides=overrides or ())
    files = _files(out, movie, f"scenario-{scenario}-{replay.method}")
    cut = ""
    with output_files.written_whole(files.folder) as folder:
        if files.picture:
            with Studio(replay.seen_at([shown]), width, _height(width), close, from_part=from_part) as studio:
                cut = studio.cut_text
                Image.fromarray(studio.still(shown)).save(folder / files.picture, optimize=True)
        if files.movie:
            half = 2 * (width // 4)
            look = {"close": close, "fine": False, "from_part": from_part}
            with Studio(replay, half, _height(half), **look) as studio, progress_bar("frames") as reported:
                film = studio.movie() if made is None else _film(studio, made, speed or 1.0)
                movies.write_movie(folder / files.movie, film, reported)
    _print_files(replay, shown if files.picture else None, files.names, made, speed or 1.0, cut, as_json)
    return 0


def _files(out: Path, movie: str | None, name: str) -> _Files:
    """Return the names of the files to write.

    Args:
        out: Value of --out: a folder, a movie file, or a picture (.png).
        movie: Value of --movie: the kind of movie; None if it is not set.
        name: Stem of the files in a folder.

    Raises:
        InputError: If --out is a file of another kind than --movie.
    """
    if _is_picture(out):
        if movie not in (None, "none"):
            raise InputError(f"--out {out} is a picture, but --movie is {movie}; omit --movie")
        return _Files(out.parent, out.name, None)
    if (kind := out.suffix[1:].lower()) in movies.KINDS:
        if movie not in (None, kind):
            raise InputError(f"--out {out} is a {kind} file, but --movie is {movie}; omit --movie")
        movies.check_kind(kind)
        return _Files(out.parent, None, out.name)
    return _Files(out, f"{name}.png", None if movie == "none" else f"{name}.{movie or movies.KINDS[0]}")


def _is_picture(out: Path) -> bool:
    return out.suffix.lower() == ".png"


def _film(studio: Studio, made: PlanProgram, speed: float) -> movies.Film:
    """Return the film of a robot program at `speed` times real time, with plots of the speeds below the picture."""
    play = sample_program(made, frame_times(made.program.duration_s, speed))
    return studio.film(arms_of(made, play)).over(viewer.plot_strip.PlotStrip(made, play, studio.width, speed).at)


def _height(width: int) -> int:
    return 2 * round(width * ASPECT / 2)


def _print_files(
    replay: Replay,
    shown: int | None,
    files: list[str],
    made: PlanProgram | None,
    speed: float,
    cut: str,
    as_json: bool,
) -> None:
    tracked = f"{replay.tracked} of {len(replay.target)}"
    if as_json:
        record = {"scenario": replay.number, "method": replay.method, "tracked": replay.tracked}
        record |= {"targets": len(replay.target), "failed": replay.failed, "shown": shown}
        if made is not None:
            record["program"] = {**_lasts(made), "speed": speed}
        print_json({**record, "motion": replay.summary.record(), "files": files})
        return
    facts = {**replay.summary.facts(), "targets tracked": tracked}
    if shown is not None:
        facts["the arm is at"] = f"target {shown}"
    if cut:
        facts["part"] = cut
    if replay.failed is not None:
        facts["failed at"] = f"target {replay.failed}"
    if replay.obstruction is not None:
        facts[replay.obstruction.heading] = replay.obstruction.description
    if made is not None:
        facts["program"] = "{duration_s:.2f} s at {feed_mm_s:g} mm/s, shown {how}".format(
            **_lasts(made), how=viewer.plot_strip.shown_as(speed)
        )
    print_facts(f"{replay.method}, scenario {replay.label}", facts | {"files": ", ".join(files)})


def _lasts(made: PlanProgram) -> dict[str, float]:
    return {"duration_s": made.program.duration_s, "feed_mm_s": 1e3 * made.program.feed_m_s}

"""Pictures of a placement search in its folder: map.png, best-1.png to best-3.png, and pareto_front.png.

draw_search("out/duct")
"""

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Int

from htcp_jax.placement import mounting
from htcp_jax.report.cell import OpenedScene
from htcp_jax.report.charts.placement import place_map, place_pareto_front
from htcp_jax.report.charts.style import INK
from htcp_jax.report.document import png
from htcp_jax.report.place_tables import SearchTable, read_search
from htcp_jax.runs import Run, open_run
from htcp_jax.runs import open as plan_sets
from htcp_jax.system import files
from htcp_jax.viewer import recorded_replays

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BEST = 3  # number of mountings with pictures
SAMPLE = 64  # number of failed mountings whose colliding bodies are determined


def draw_search(folder: str | Path) -> list[Path]:
    """Draw the results of a placement search into its folder, and return the pictures' files.

    There is a pareto_front.png only for two objectives.

    Raises:
        InputError: If the folder contains no finished search, or if a file is damaged.
    """
    folder = Path(folder)
    found = read_search(folder)
    figures = {"map": place_map(found, colliding_bodies(folder, found))}
    if len(found.objectives) > 1 and len(found.ranked):
        figures["pareto_front"] = place_pareto_front(found)
    figures |= {f"best-{rank}": figure for rank, figure in best_pictures(folder, found).items()}
    return [_save_figure(folder / f"{name}.png", figure) for name, figure in figures.items()]


def best_pictures(folder: Path, found: SearchTable) -> "dict[int, Figure]":
    """Draw the best mountings, each at its seam with the smallest guaranteed clearance.

    Returns:
        The figures by rank; empty if no mounting is ranked, or if the job's files have changed.
    """
    if not len(found.ranked):
        return {}
    run = open_run(folder / plan_sets.MOTIONS)
    (method,) = run.methods
    plans, k = run.plans(method), len(found.seams)
    scene, figures = OpenedScene(run, {method: plans}), {}
    clearance = np.where(plans.executable, plans.segment_clearance, np.inf).min(axis=1)
    for rank in range(1, min(BEST, len(found.ranked)) + 1):
        seams = range((rank - 1) * k, rank * k)
        number = min(seams, key=lambda scenario: float(clearance[scenario]))
        figure = scene.picture(number, method, _title(found, rank, list(found.seams)[number - seams.start]))
        if figure is not None:
            figure.supxlabel(_given(found, rank), color=INK, fontsize=12, x=0.015, ha="left")
            figures[rank] = figure
    return figures


def colliding_bodies(folder: Path, found: SearchTable) -> dict[str, int]:
    """Return the colliding bodies in an even sample of the failed mountings, with counts, most frequent first."""
    lost = np.flatnonzero(~found.complete)
    picked = lost[np.linspace(0, len(lost) - 1, min(SAMPLE, len(lost))).round().astype(int)]
    k, first, counts = len(found.seams), 0, Counter[str]()
    for each in sorted((folder / "rounds").iterdir()):
        run = open_run(each)
        last = first + run.manifest.count // k
        own = picked[(picked >= first) & (picked < last)] - first
        if len(own):
            counts.update(_blocking(run, own, k))
        first = last
    return dict(counts.most_common())


def _blocking(run: Run, mountings: Int[np.ndarray, "m"], k: int) -> list[str]:
    """Return the colliding body of each failed mounting in `mountings`, at its first failed seam.

    Args:
        run: The run of the round.
        mountings: Indices of the mountings in the round.
        k: The number of seams.
    """
    (method,) = run.methods
    plans = run.plans(method)
    whole = plans.outcomes.can_be_driven.reshape(-1, k)
    rows = (mountings * k + whole[mountings].argmin(axis=1)).tolist()
    found = recorded_replays(plan_sets.plans_of_run(run), {method: plans}.__getitem__).obstructions(method, rows)
    return [each.cause("no body collides") for each in found.values()]


def _title(found: SearchTable, rank: int, seam: str) -> str:
    left = [
        f"{name} {objective:.3g} {mounting.UNITS[name][0]}" + (f", {off:.3g} perturbed" if np.isfinite(off) else "")
        for name, objective, off in zip(found.objectives, found.objective[rank - 1], found.worst[rank - 1], strict=True)
    ]
    if np.isfinite(found.margin[rank - 1]):
        left.append(f"margin {found.margin[rank - 1]:.3g} mm")
    return f"Rank {rank}: {'; '.join(left)}" + (f"; at the seam {seam}" if len(found.seams) > 1 else "")


def _given(found: SearchTable, rank: int) -> str:
    values = found.ranked[rank - 1].tolist()
    return ",  ".join(f"{one.name} {v:.4g} {one.unit}".strip() for one, v in zip(found.parameters, values, strict=True))


def _save_figure(file: Path, figure: "Figure") -> Path:
    files.write_atomically(file.parent, file.name, png(figure))
    return file

"""Seams in a program's file, and the outputs that the job sets at their ends."""

from pathlib import Path

import numpy as np

from htcp_jax.errors import InputError
from htcp_jax.spec import PlanConfig
from htcp_jax.status import Kind
from htcp_jax.trajectory.controller_data import ProcessOutputs, SeamSpan
from htcp_jax.trajectory.formats.writers import FORMATS, format_of
from htcp_jax.trajectory.timed_motion import TimedMotion


def seam_spans(job: PlanConfig, timed: TimedMotion, seam_begins: tuple[int, ...]) -> tuple[SeamSpan, ...]:
    """Return the rows between which the tool follows each seam of a job, in the order of work.

    A dwell between two targets of a seam belongs to the seam. A seam of one target has one row.

    Args:
        job: The job.
        timed: Samples in the file.
        seam_begins: First targets of the second and of each later seam.
    """
    names = [seam.name for seam in job.workpiece.seams] or [Path(job.workpiece.path).stem]
    seam = np.searchsorted(seam_begins, timed.target, "right")
    on_path, spans = timed.is_process, []
    for k in range(1 + len(seam_begins)):
        own = np.flatnonzero(on_path & (seam == k))
        name = names[k] if k < len(names) else str(k + 1)
        if len(own):
            spans.append(SeamSpan(name, max(int(own[0]) - 1, 0), int(own[-1])))
        elif len(at := np.flatnonzero((seam == k) & (timed.kind != Kind.RETRACT))):
            spans.append(SeamSpan(name, int(at[-1]), int(at[-1])))
    return tuple(spans)


def process_outputs(job: PlanConfig, format: str) -> ProcessOutputs:
    """Return the outputs of a job's section `program.process`.

    Args:
        job: The job.
        format: Name of the format in `writers.FORMATS`.

    Raises:
        InputError: If the job has outputs and the format has none.
    """
    if (stated := job.program.process) is None or not (stated.on or stated.off):
        return ProcessOutputs()
    if not format_of(format).outputs:
        valid = ", ".join(name for name, each in FORMATS.items() if each.outputs)
        raise InputError(f"{format} has no outputs, which program.process sets; omit the key, or use {valid}")
    return ProcessOutputs(stated.on, stated.off)

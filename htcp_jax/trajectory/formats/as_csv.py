"""CSV format of robot programs: one line per sample; numbers have nine decimals."""

import csv
import io
from bisect import bisect_left

import numpy as np

from htcp_jax.status import Kind
from htcp_jax.trajectory.controller_data import ControllerData, header
from htcp_jax.trajectory.timed_motion import TimedMotion


def csv_text(timed: TimedMotion, controller: ControllerData) -> str:
    """Return the file's text: comments after #, a line with the columns' names, and rows.

    The columns are `time_s`, `kind`, `target`, with several seams `seam`, and for each joint its value `<joint>_rad`,
    its velocity `<joint>_rad_s` and its acceleration `<joint>_rad_s2`; for a slide m replaces rad.
    """
    timed, stream = timed.rounded, io.StringIO()
    stream.writelines(f"# {line}\n" for line in header(timed))
    units = ["m" if slides else "rad" for slides in controller.slides]
    names = [f"{name}_{unit}" for name, unit in zip(timed.joint_names, units, strict=True)]
    rates = [f"{name}{per}" for per in ("", "_s", "_s2") for name in names]
    writer = csv.writer(stream, lineterminator="\n")
    has_seams, ends = len(controller.seams) > 1, [seam.last for seam in controller.seams[:-1]]
    writer.writerow(["time_s", "kind", "target", *(["seam"] if has_seams else []), *rates])
    states = np.hstack([timed.x, timed.velocity, timed.acceleration])
    columns = (column.tolist() for column in (timed.time_s, timed.kind, timed.target, states))
    for row, (time_s, kind, target, state) in enumerate(zip(*columns, strict=True)):
        seam = [controller.seams[bisect_left(ends, row)].name] if has_seams else []
        writer.writerow([time_s, Kind(kind).name, target, *seam, *state])
    return stream.getvalue()

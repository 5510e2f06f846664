"""Texts on scenarios and targets for the page."""

import numpy as np

from htcp_jax.markup import escaped
from htcp_jax.model import robot as robots
from htcp_jax.motion import plans
from htcp_jax.status import SegmentStatus, Status
from htcp_jax.viewer.replay import Replay, Replays, ShownFile


def describe(outcome: plans.Outcome, replays: Replays) -> str:
    """Return a scenario's number, its number of tracked targets, and its varied parameters, as one line."""
    count = (
        f"all {outcome.targets} tracked" if outcome.complete else f"failed at {outcome.tracked} of {outcome.targets}"
    )
    return "; ".join(filter(None, (f"{outcome.scenario}: {count}", replays.labels.get(outcome.scenario))))


def name_of(names: dict[str, int], number: int) -> str | None:
    """Return the name whose value is `number`; None if there is none."""
    return next((name for name, known in names.items() if known == number), None)


def target_facts(replay: Replay, target: int) -> str:
    """Return a description of a target's result, in Markdown."""
    if replay.file is not None:
        return _file_facts(replay, replay.file, target)
    status = Status(int(replay.status[target]))
    what = f"**Target {target}** {status.message}"
    if target == replay.failed and replay.obstruction is not None:
        there = " in collision" if replay.obstruction.collides else ""
        return f"{what}.\n\nThe arm is shown there{there}: {escaped(replay.obstruction.description)}."
    if not status.tracked:
        return f"{what}.\n\nThe arm is shown at the last tracked target."
    here = f"Clearance at the target **{1e3 * replay.clearance[target]:.4g} mm** ({_nearest(replay, target)}). "
    here += f"TCP error {1e3 * replay.residual[target]:.2f} mm"
    if not np.isnan(angle := replay.orientation_error[target]):
        here += f", orientation error {np.rad2deg(angle):.3g} deg"
    return f"{what}.\n\n{here}.\n\n{_segment_text(replay, target)}"


def _file_facts(replay: Replay, file: ShownFile, target: int) -> str:
    """Return a description of a configuration of a file, and of the segment to it, in Markdown."""
    clearance, body = 1e3 * replay.clearance[target], _nearest(replay, target)
    here = f"clearance **{clearance:.4g} mm**" if clearance > 0 else f"in collision, **{-clearance:.4g} mm** deep"
    place = file.places[target].capitalize()
    return f"**{escaped(place)}**: {here} ({body}).\n\n{escaped(file.segments[target])}"


def _nearest(replay: Replay, target: int) -> str:
    """Return the label of the body that is nearest to an obstacle at a target, for Markdown."""
    return escaped(robots.capsule_label(replay.robot, replay.witness.body[target]))


def _segment_text(replay: Replay, target: int) -> str:
    """Return a description of the segment to a target, and of a dwell at the target."""
    known = SegmentStatus(int(replay.segment_status[target]))
    text = f"Segment to this target: {known.message}"
    if known.is_motion:
        text = (
            f"The segment to this target is {known.words}: {1e3 * replay.segment_clearance[target]:.3g} mm "
            "clear at least"
        )
    minimum = " It is the minimum of the motion." if target == replay.summary.clearance_target else ""
    dwells = " **The arm changes its configuration here.**" if target in replay.summary.dwells else ""
    return f"{text}.{minimum}{dwells}"

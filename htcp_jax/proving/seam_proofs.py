"""Seams in the proof of a file: the required clearance on each, and what is proven there."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from htcp_jax.errors import mm_text
from htcp_jax.io.motions import MotionFile
from htcp_jax.jobs import margin_of
from htcp_jax.proving.path_deviation import seams_of_segments
from htcp_jax.proving.prove import MotionProof
from htcp_jax.proving.scene import ProofScene


class SeamProof(NamedTuple):
    """Proof of the segments of a motion that lead along one seam."""

    seam: str  # its name
    margin_m: float  # required clearance; 0: any above 0
    segments: int  # number of segments
    verdict: str  # "proven", "refuted" or "undecided"
    clearance_m: float | None  # guaranteed clearance [m]; None if it is not proven, or without obstacles


class SeamSegments(NamedTuple):
    """Seams of a motion's segments, and the clearance that each requires."""

    names: tuple[str, ...]
    margin_m: tuple[float, ...]  # required on each seam; 0: any above 0
    seam: Int[np.ndarray, "m"]  # number of each segment's seam; -1 between seams

    @property
    def required_m(self) -> Float[np.ndarray, "m"]:
        """Required clearance on each segment [m]; 0: any above 0."""
        return np.append(self.margin_m, 0.0)[self.seam]

    def proofs(self, found: MotionProof) -> tuple[SeamProof, ...]:
        """Return the proof of each seam that the motion follows."""
        return tuple(self._proof(found, number) for number in np.unique(self.seam[self.seam >= 0]).tolist())

    def _proof(self, found: MotionProof, number: int) -> SeamProof:
        own = MotionProof(*(each[self.seam == number] for each in found.arrays))
        verdict = "proven" if own.proven else "refuted" if own.refuted else "undecided"
        least = float(own.guaranteed_m)
        known = least if np.isfinite(least) else None
        return SeamProof(self.names[number], self.margin_m[number], len(own.verdict), verdict, known)


def seam_segments(scene: ProofScene, motion: MotionFile, margin_m: float | None) -> SeamSegments | None:
    """Return the seams of a motion's segments; None for a job of one seam.

    Args:
        scene: The scene.
        motion: The motion, of joint values.
        margin_m: Required clearance everywhere; None: if a seam has a margin of its own, each seam's own or else the
            job's, and any above 0 between seams and for `margin_on: targets`.
    """
    seams = () if scene.job is None or not scene.has_part else scene.job.workpiece.seams
    if scene.job is None or len(seams) < 2:
        return None
    own = [0.0 if margin_m is None else margin_m] * len(seams)
    if margin_m is None and scene.job.margin_on == "segments" and any(seam.margin_m is not None for seam in seams):
        own = [margin_of(scene.job, seam) for seam in seams]
    names = tuple(seam.name for seam in seams)
    return SeamSegments(names, tuple(own), seams_of_segments(scene.problem, motion.x, motion.kind))


def seams_text(seams: Sequence[SeamProof], most: int) -> str:
    """Return the guaranteed clearance on seams as text: on `most` of them, the smallest first."""
    ranked = sorted(seams, key=lambda each: (each.verdict == "proven", each.clearance_m or np.inf))
    more = f"; and {len(ranked) - most} more, see proof.json" if len(ranked) > most else ""
    return "; ".join(map(_seam_text, ranked[:most])) + more


def _seam_text(each: SeamProof) -> str:
    required = f" ({1e3 * each.margin_m:g} mm required)" if each.margin_m else ""
    if each.verdict != "proven":
        return f"{each.seam} {each.verdict}{required}"
    return f"{each.seam} at least {mm_text(each.clearance_m)}{required}" if each.clearance_m else each.seam

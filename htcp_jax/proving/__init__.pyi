from .curves import JointCurves, corners, polynomials, straight
from .file_proof import FileProof, motion_curves, prove_file
from .program_proof import ProgramProof, prove_program
from .proof_record import (
    PICTURE,
    counts,
    exit_code,
    headline,
    limit_text,
    lines_of,
    proof_record,
    unproven_groups,
    write_proof,
)
from .prove import MotionProof, prove, prove_curves
from .scene import scene_of
from .worst import Contact, deepest_contact, deepest_contacts

__all__ = [
    "PICTURE",
    "Contact",
    "FileProof",
    "JointCurves",
    "MotionProof",
    "ProgramProof",
    "corners",
    "counts",
    "deepest_contact",
    "deepest_contacts",
    "exit_code",
    "headline",
    "limit_text",
    "lines_of",
    "motion_curves",
    "polynomials",
    "proof_record",
    "prove",
    "prove_curves",
    "prove_file",
    "prove_program",
    "scene_of",
    "straight",
    "unproven_groups",
    "write_proof",
]

from . import proof_record
from .curves import JointCurves, corners, polynomials, straight
from .file_proof import FileProof, motion_curves, prove_file
from .path_deviation import IndexedTravel
from .program_proof import ProgramProof, prove_program, prove_with_exact_corners
from .prove import MotionProof, prove, prove_curves
from .scene import ProofScene, scene_of
from .worst import Contact, deepest_contact, deepest_contacts

__all__ = [
    "Contact",
    "FileProof",
    "IndexedTravel",
    "JointCurves",
    "MotionProof",
    "ProgramProof",
    "ProofScene",
    "corners",
    "deepest_contact",
    "deepest_contacts",
    "motion_curves",
    "polynomials",
    "proof_record",
    "prove",
    "prove_curves",
    "prove_file",
    "prove_program",
    "prove_with_exact_corners",
    "scene_of",
    "straight",
]

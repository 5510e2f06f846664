from . import proof_record
from .curves import JointCurves, corners, polynomials, straight
from .file_proof import FileProof, motion_curves, prove_file
from .path_deviation import IndexedTravel
from .program_proof import ProgramProof, prove_program, prove_with_exact_corners
from .prove import MotionProof, prove, prove_curves
from .scaled_errors import ErrorScale, error_scale
from .scene import ProofScene, scene_of
from .seam_proofs import seams_text
from .stated_errors import error_set, errors_record, scale_text
from .worst import Contact, deepest_contact, deepest_contacts

__all__ = [
    "Contact",
    "ErrorScale",
    "FileProof",
    "IndexedTravel",
    "JointCurves",
    "MotionProof",
    "ProgramProof",
    "ProofScene",
    "corners",
    "deepest_contact",
    "deepest_contacts",
    "error_scale",
    "error_set",
    "errors_record",
    "motion_curves",
    "polynomials",
    "proof_record",
    "prove",
    "prove_curves",
    "prove_file",
    "prove_program",
    "prove_with_exact_corners",
    "scale_text",
    "scene_of",
    "seams_text",
    "straight",
]

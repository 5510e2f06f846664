from .curves import JointCurves, corners, polynomials, straight
from .prove import MotionProof, prove, prove_curves
from .scene import scene_of
from .worst import Contact, deepest_contact

__all__ = [
    "Contact",
    "JointCurves",
    "MotionProof",
    "corners",
    "deepest_contact",
    "polynomials",
    "prove",
    "prove_curves",
    "scene_of",
    "straight",
]

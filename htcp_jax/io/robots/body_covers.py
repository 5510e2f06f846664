"""Capsules and convex pieces that enclose the shapes of one body."""

import itertools
from typing import NamedTuple

import numpy as np

from htcp_jax.errors import InputError
from htcp_jax.io.robots import capsule_fit, close_fit
from htcp_jax.io.robots.capsule_fit import Capsule, MeshPiece, Triangles
from htcp_jax.io.robots.shapes import Shape
from htcp_jax.io.robots.stored_pieces import StoredPiece, reduced_piece


class BodyCover(NamedTuple):
    """Capsules of one body, and the shapes that they represent."""

    own: dict[str, Capsule]  # the model's own capsules, by name
    pieces: dict[str, MeshPiece]  # pieces of `enclosed` with their fitted capsules, by name
    hulls: dict[str, StoredPiece]  # convex pieces for `pieces`, by name
    # largest distance of each fitted capsule's surface outside of the others from `enclosed` [m], by name
    excesses: dict[str, float]
    drawn: Triangles  # triangles of the meshes to which MuJoCo fitted the model's own capsules [m]
    enclosed: Triangles  # triangles of all other shapes, which the fitted capsules enclose [m]
    kinds: tuple[str, ...]  # types of the enclosed shapes: box, mesh, ...

    def with_pieces(self, pieces: dict[str, MeshPiece]) -> "BodyCover":
        """Return the cover with other pieces of `enclosed`, by the names of their capsules."""
        hulls = {
            name: self.hulls[name] if piece is self.pieces.get(name) else reduced_piece(piece.triangles.reshape(-1, 3))
            for name, piece in pieces.items()
        }
        capsules = [piece.capsule for piece in pieces.values()]
        excess = close_fit.excesses_m(self.enclosed, capsules) if pieces else []
        return self._replace(pieces=pieces, hulls=hulls, excesses=dict(zip(pieces, excess, strict=True)))

    @property
    def fitted(self) -> dict[str, Capsule]:
        """The capsules of the pieces, by name."""
        return {name: piece.capsule for name, piece in self.pieces.items()}

    @property
    def ratio(self) -> float:
        """Volume of the fitted capsules' union, divided by the volume of the convex hull of `enclosed`.

        nan if nothing was fitted, and if all shapes are flat.
        """
        hull = capsule_fit.hull_volume(self.enclosed.reshape(-1, 3)) if self.fitted else 0.0
        return close_fit.union_volume(list(self.fitted.values())) / hull if hull else np.nan

    @property
    def excess_m(self) -> float:
        """Largest distance of the fitted capsules' surface from `enclosed` [m]; nan if nothing was fitted."""
        return max(self.excesses.values(), default=np.nan)

    @property
    def outside_m(self) -> float:
        """Largest distance of a corner of `drawn` from the model's own capsules [m]; 0 if all are inside."""
        corners = self.drawn.reshape(-1, 3)
        if not len(corners):
            return 0.0
        return max(0.0, -float(np.max([capsule.depth(corners) for capsule in self.own.values()], axis=0).min()))


def new_name(wish: str, given: set[str]) -> str:
    """Return `wish`, or wish_2, wish_3, ... if that name is in `given`, and add it to `given`."""
    tries = itertools.chain([wish], (f"{wish}_{k}" for k in itertools.count(2)))
    name = next(each for each in tries if each not in given)
    given.add(name)
    return name


class CapsuleFit:
    """Fits of capsules to meshes. Equal meshes are fitted once, as a robot with two arms has each mesh twice.

    Raises:
        InputError: For a tolerance out of range.
    """

    def __init__(self, most: int | None, tolerance_m: float | None):
        low, high = close_fit.TOLERANCES_M
        if tolerance_m is not None and not low <= tolerance_m <= high:
            raise InputError(
                f"the tolerance of the fit is {1e3 * tolerance_m:g} mm; valid: {1e3 * low:g} to {1e3 * high:g} mm"
            )
        self._most, self._tolerance_m = most, tolerance_m
        self._known: dict[tuple[bytes, bool], list[MeshPiece]] = {}

    def pieces(self, triangles: Triangles, close: bool) -> list[MeshPiece]:
        """Return a mesh's pieces with their capsules, within the tolerance if `close`."""
        key = triangles.tobytes(), close
        if key not in self._known:
            self._known[key] = self._fitted(triangles, close)
        return self._known[key]

    def _fitted(self, triangles: Triangles, close: bool) -> list[MeshPiece]:
        most = self._most
        if self._tolerance_m is None:
            more = 0 if most else capsule_fit.MORE_PIECES
            return capsule_fit.cover_with_capsules(triangles, most or capsule_fit.MOST, more)
        if close:
            return close_fit.cover_closely(triangles, most or close_fit.MOST_CLOSE, self._tolerance_m)
        return close_fit.cover_closely(triangles, min(most or close_fit.MOST, close_fit.MOST))


def cover_body(shapes: list[Shape], body: str, names: set[str], fit: CapsuleFit, close: bool) -> BodyCover:
    """Enclose the shapes of a body in capsules.

    Args:
        shapes: The shapes.
        body: Name of the body.
        names: Names that capsules must not have; the new names are added.
        fit: The fit.
        close: True to fit within the tolerance.
    """
    given, others = ([each for each in shapes if (each.capsule is None) == is_fitted] for is_fitted in (False, True))
    own = {shape.name or new_name(body, names): shape.capsule for shape in given}
    held = joined(others)
    pieces = {new_name(body, names): piece for piece in (fit.pieces(held, close) if others else [])}
    kinds = tuple(shape.kind for shape in others)
    return BodyCover(own, {}, {}, {}, joined(given), held, kinds).with_pieces(pieces)


def joined(shapes: list[Shape]) -> Triangles:
    """Return the triangles of all shapes [m]."""
    return np.concatenate([np.empty((0, 3, 3)), *(shape.triangles for shape in shapes)])

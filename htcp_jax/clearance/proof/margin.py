"""Required clearance along a motion, as data of its proof.

It is constant, or falls off towards both ends of a motion. With p the TCP, and e_k its position at an end where the arm
has a clearance of d_k, the required clearance is

    r(x) = min(m, r_1(x), r_2(x))        r_k(x) = d_k + (m - d_k) |p(x) - e_k| / f

with m the margin and f the distance within which it falls off. r is a function of the configuration alone, so any part
of a motion can be proven separately. On an interval on which the TCP moves by at most t, r grows by less than if
|p - e_k| grew by t.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from htcp_jax.types import Anywhere, Float, Scalar, Vector3

END_M = 1e-6  # part of an end's clearance that is not required there, for rounding


class Margin(NamedTuple):
    """Required clearance on a joint path, or a table of n such rules."""

    most_m: Float[Anywhere, "*n"]  # m [m]; -inf: only D > 0 is required
    end: Float[Anywhere, "*n 2 3"]  # e_k, world [m]
    at_end_m: Float[Anywhere, "*n 2"]  # d_k [m]; inf: the margin does not fall off
    rate: Float[Anywhere, "*n 2"]  # (m - d_k) / f [1]

    def scaled(self, share: float) -> "Margin":
        """Return the rule with `share` times the required clearance everywhere."""
        return self._replace(most_m=share * self.most_m, at_end_m=share * self.at_end_m, rate=share * self.rate)

    def at(self, tcp: Vector3, travel: Scalar | float = 0.0) -> Scalar:
        """Return the largest required clearance with the TCP at most `travel` from `tcp` [m].

        Args:
            tcp: Position of the TCP, world [m].
            travel: Largest distance from it [m].
        """
        apart = self.end - tcp[None]
        within = self.at_end_m + self.rate * (jnp.sqrt(jnp.sum(apart * apart, axis=-1)) + travel)
        return jnp.minimum(self.most_m, jnp.min(within))


def constant(margin_m: Float[np.ndarray, "n"]) -> Margin:
    """Return rules that require the same clearance everywhere [m]; -inf: only D > 0."""
    count = len(margin_m)
    return Margin(margin_m, np.zeros((count, 2, 3)), np.full((count, 2), np.inf), np.zeros((count, 2)))


def falling_off(
    margin_m: Float[np.ndarray, "n"],
    falloff_m: Float[np.ndarray, "n"],
    end: Float[np.ndarray, "n 2 3"],
    clearance: Float[np.ndarray, "n 2"],
) -> Margin:
    """Return rules that fall off towards both ends of motions.

    Args:
        margin_m: Required clearances far from the ends [m]; 0: only D > 0.
        falloff_m: Distances of the TCP from an end within which the required clearance falls off [m].
        end: Positions of the TCP at the ends, world [m].
        clearance: Clearances at the ends [m].
    """
    at_end = np.clip(clearance - END_M, 0.0, margin_m[:, None])
    return Margin(
        np.where(margin_m > 0, margin_m, -np.inf), end, at_end, (margin_m[:, None] - at_end) / falloff_m[:, None]
    )

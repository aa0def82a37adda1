"""Which geometries may touch those of a body, by balls around them."""

import numpy as np

from zensim.sim_server.physics.casting.wishes import Places
from zensim.sim_server.physics.engine import FloatArray


def nearby(centres: FloatArray, radii: FloatArray, own: Places) -> Places:
    """Find the geometries that reach into the ball around some of them.

    Args:
        centres: (n, 3) of all.
        radii: (n,) of the balls around all.
        own: Which of them the ball is around; they are among those found.
    """
    if not len(own):
        return own
    middle = centres[own].mean(axis=0)
    reach = float((np.linalg.norm(centres[own] - middle, axis=1) + radii[own]).max())
    apart = centres - middle
    return np.flatnonzero(np.einsum("ij,ij->i", apart, apart) <= (radii + reach) ** 2)

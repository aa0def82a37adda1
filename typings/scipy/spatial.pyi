"""The part of SciPy that makes hulls, for tests."""

import numpy as np
from numpy.typing import NDArray

class ConvexHull:
    volume: float
    def __init__(self, points: NDArray[np.float64]) -> None: ...

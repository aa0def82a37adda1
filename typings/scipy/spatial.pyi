"""The part of SciPy that makes hulls."""

import numpy as np
from numpy.typing import NDArray

class QhullError(RuntimeError): ...

class ConvexHull:
    simplices: NDArray[np.int64]
    def __init__(self, points: NDArray[np.float64], *, qhull_options: str = ...) -> None: ...

"""The part of scipy.optimize that tests call."""

import numpy as np
import numpy.typing as npt

_Floats = npt.NDArray[np.float64]

class OptimizeResult:
    success: bool
    fun: float

def linprog(c: _Floats, *, A_eq: _Floats, b_eq: list[float]) -> OptimizeResult: ...  # noqa: N803

"""Columns of arrays with a row a robot, and how rows are carried over when robots come and go."""

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]
NEW = -1
"""Stands for a row that was not there before."""


def carried(column: FloatArray, before: IntArray, fresh: float = 0.0) -> FloatArray:
    """Cut a column anew.

    Args:
        column: (n, ...).
        before: Where each of the rows-to-be was, or `NEW`; (m,).
        fresh: What new rows hold.
    """
    out = np.full((len(before), *column.shape[1:]), fresh)
    is_kept = before != NEW
    out[is_kept] = column[before[is_kept]]
    return out


def carried_ints(column: IntArray, before: IntArray) -> IntArray:
    """Cut a column of whole numbers anew; new rows hold 0."""
    out = np.zeros((len(before), *column.shape[1:]), dtype=np.int64)
    is_kept = before != NEW
    out[is_kept] = column[before[is_kept]]
    return out


def carried_flags(column: BoolArray, before: IntArray) -> BoolArray:
    """Cut a column of flags anew; new rows are False."""
    out = np.zeros(len(before), dtype=np.bool_)
    is_kept = before != NEW
    out[is_kept] = column[before[is_kept]]
    return out

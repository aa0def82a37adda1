"""Arithmetic of drives on arrays; not in column_math, as single agents do not load numpy."""

import numpy as np
import numpy.typing as npt

from zensim.proto.drives.column_math import ColumnMath


def _all_true(condition: npt.NDArray[np.bool_]) -> bool:
    return bool(condition.all())


ARRAY_MATH: ColumnMath[npt.NDArray[np.float64]] = ColumnMath(
    minimum=np.minimum,
    maximum=np.maximum,
    where=np.where,
    copysign=np.copysign,
    sin=np.sin,
    cos=np.cos,
    tan=np.tan,
    arctan2=np.arctan2,
    all_true=_all_true,
)

"""Very many numbers, separated by blanks, at once."""

import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray


def leading_numbers(text: bytes, kind: type[np.number[Any]]) -> NDArray[Any]:
    """Read numbers up to the end, or to the first word that is none."""
    with warnings.catch_warnings():
        # What is no number ends the reading with this warning, in newer versions with an error.
        warnings.simplefilter("ignore", DeprecationWarning)
        try:
            return np.fromstring(text.decode("ascii"), kind, sep=" ")
        except ValueError:
            return np.zeros(0, kind)

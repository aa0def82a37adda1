"""Numbers of a text, up to the first word that is none."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


def read_leading_numbers(text: bytes, kind: type[np.number[Any]]) -> NDArray[Any]:
    """Read numbers up to the first word that is not a number."""
    with warnings.catch_warnings():
        # numpy reports such a word by a warning, newer versions by an error.
        warnings.simplefilter("ignore", DeprecationWarning)
        try:
            return np.fromstring(text.decode("ascii"), kind, sep=" ")
        except ValueError:
            return np.zeros(0, kind)

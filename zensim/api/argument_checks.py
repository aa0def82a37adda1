"""Checks of arguments: numbers that are numbers, finite, and in range."""

import math

import numpy as np
import numpy.typing as npt

from zensim.api.api_errors import Invalid

FloatArray = npt.NDArray[np.float64]
MAX_NUMBER = 1e6
"""Limit of positions [m] and velocities [m/s], [rad/s]; engines fail far beyond."""


def make_numbers(what: str, given: object, shape: str) -> FloatArray:
    """Make an array of numbers.

    Raises:
        Invalid: They are not numbers, or rows have different lengths.
    """
    try:
        return np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise Invalid(
            f"{what} {str(given)[:80]!r} are not numbers", hint=f"give numbers of shape {shape}"
        ) from error


def check_finite(what: str, numbers: FloatArray, shape: str) -> FloatArray:
    """Return numbers that are all finite.

    Raises:
        Invalid: Some are not; the message names their rows.
    """
    if not np.isfinite(numbers).all():
        rows = np.flatnonzero(~np.isfinite(numbers).reshape(len(numbers), -1).all(axis=1))
        raise Invalid(
            f"{what} is not finite in rows {rows[:5].tolist()}",
            slug="not_finite",
            hint=f"give finite numbers of shape {shape}",
        )
    return numbers


def check_limits(
    what: str, numbers: FloatArray, shape: str, most: float = MAX_NUMBER
) -> FloatArray:
    """Return numbers that are finite and not absurdly large.

    Raises:
        Invalid: Some are; the message names their rows.
    """
    check_finite(what, numbers, shape)
    if numbers.size and np.abs(numbers).max() > most:
        raise Invalid(f"{what} has numbers beyond {most:g}", hint=f"give numbers of shape {shape}")
    return numbers


def check_range(what: str, number: object, least: float, most: float) -> None:
    """Check that a number is within limits.

    Raises:
        Invalid: It is not, or it is no number.
    """
    if isinstance(number, int | float | np.integer | np.floating) and least <= number <= most:
        return
    raise Invalid(f"{what}={str(number)[:40]} is out of range", hint=f"use {least:g} to {most:g}")


def check_whole(what: str, number: object, least: int, most: int) -> None:
    """Check that a number is whole and within limits.

    Raises:
        Invalid: It is not, or it is no number.
    """
    hint = f"use {least} to {most}"
    if isinstance(number, bool) or not isinstance(number, int | np.integer):
        raise Invalid(f"{what}={str(number)[:40]} is not a whole number", hint=hint)
    if not least <= number <= most:
        raise Invalid(f"{what}={number} is out of range", hint=hint)


def check_real(what: str, number: object) -> None:
    """Check that an argument is a finite number.

    Raises:
        Invalid: It is not.
    """
    if isinstance(number, bool) or not isinstance(number, int | float | np.integer | np.floating):
        raise Invalid(f"{what}={str(number)[:40]} is not a number", hint="give a finite number")
    if not math.isfinite(number):
        raise Invalid(
            f"{what}={number} is not finite", slug="not_finite", hint="give a finite number"
        )


def check_text(what: str, given: object) -> None:
    """Check that an argument is a text.

    Raises:
        Invalid: It is not.
    """
    if not isinstance(given, str):
        raise Invalid(f"{what}={str(given)[:40]} is no text", hint="give a name as str")

"""Quantities of scenario files: numbers with units, and draws of random numbers."""

import hashlib
import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec
from msgspec import Meta

UNITS: Mapping[str, Mapping[str, float]] = {
    "m": {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "km": 1e3},
    "rad": {"rad": 1.0, "deg": math.pi / 180.0},
    "s": {"us": 1e-6, "ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0},
    "Hz": {"Hz": 1.0, "kHz": 1e3},
    "m/s": {"mm/s": 1e-3, "cm/s": 1e-2, "m/s": 1.0, "km/h": 1.0 / 3.6},
    "rad/s": {"rad/s": 1.0, "deg/s": math.pi / 180.0, "rpm": math.pi / 30.0},
    "m/s^2": {"m/s^2": 1.0, "m/s2": 1.0},
    "N": {"N": 1.0, "kN": 1e3},
    "N m s": {"N m s": 1.0, "Nms": 1.0},
    "1": {"%": 1e-2},
}
"""Factors to the SI unit, by SI unit; `1` is a number without dimension."""
DRAW_KINDS = ("uniform", "normal", "choice")
PAIRS: Mapping[str, str] = {"uniform": "[lowest, highest]", "normal": "[mean, deviation]"}
"""Kinds of draws with two numbers."""
LEAST_SHARE = 0.01
"""Share of a normal distribution that has to be in the range of its key."""
_NUMBER = re.compile(r"([-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?)\s*([^\s0-9].*)?")


def quantity(
    unit: str,
    description: str,
    *,
    at_least: float | None = None,
    above: float | None = None,
    at_most: float | None = None,
) -> Meta:
    """Describe a number with a unit, for an annotation.

    Args:
        unit: A key of `UNITS`.
        description: One sentence of help, schema and reference.
        at_least: Smallest value.
        above: Limit below all values.
        at_most: Largest value.
    """
    limits: dict[str, Any] = {"ge": at_least, "gt": above, "le": at_most}
    return Meta(description=description, extra={"unit": unit}, **limits)


def described(description: str) -> Meta:
    """Describe a value without a unit, for an annotation."""
    return Meta(description=description)


def parse_quantity(text: str, unit: str) -> float | None:
    """Parse a number with a unit of the same dimension, to SI; None if it is none."""
    match = _NUMBER.fullmatch(text.strip())
    if match is None:
        return None
    number, word = match.groups()
    factor = 1.0 if word is None else UNITS[unit].get(word.strip())
    return None if factor is None else float(number) * factor


def list_units(unit: str) -> str:
    """List the units of a dimension as words."""
    return ", ".join(UNITS[unit])


PlainValue = Any
"""A value of a file: scalars, lists, maps and draws."""


class Draw(msgspec.Struct, frozen=True):
    """A random number [SI]: uniform between two, normal by mean and deviation, or one of a list."""

    kind: str
    """One of `DRAW_KINDS`."""
    values: tuple[float, ...]
    limits: tuple[float, float] = (-math.inf, math.inf)
    """Smallest and largest number; normal ones beyond are drawn again."""

    @property
    def share(self) -> float:
        """Share of a normal distribution that is within the limits."""
        (low, high), (mean, deviation) = self.limits, self.values
        if deviation == 0.0:
            return float(low <= mean <= high)
        below, within = (math.erf((x - mean) / deviation / math.sqrt(2.0)) for x in (low, high))
        return (within - below) / 2.0

    def draw(self, seed: int, path: str, robot: str = "") -> float:
        """Draw the number of a key for a robot; equal arguments give the same number."""
        if self.kind == "normal":
            return self._draw_normal(seed, path, robot)
        first, _ = make_uniforms(seed, path, robot)
        if self.kind == "uniform":
            low, high = self.values
            return low + first * (high - low)
        return self.values[min(int(first * len(self.values)), len(self.values) - 1)]

    def _draw_normal(self, seed: int, *key: str) -> float:
        """Draw until it is within the limits; files have a `share` of `LEAST_SHARE` or more."""
        (low, high), (mean, deviation) = self.limits, self.values
        found = math.nan
        while not low <= found <= high:
            first, second = make_uniforms(seed, *key)
            radius = math.sqrt(-2.0 * math.log(1.0 - first))
            found = mean + deviation * radius * math.cos(2.0 * math.pi * second)
            key = (*key, "again")
        return found


def can_draw(kind: str, values: Sequence[float]) -> bool:
    """Whether a kind of draw can draw from its numbers."""
    if kind == "uniform":
        return values[0] <= values[1]
    return kind != "normal" or values[1] >= 0.0


MAY_HAVE_DRAWS = (dict, list, Draw)
"""Classes of the values of a file that are, or contain, draws."""


def make_uniforms(seed: int, *key: str) -> tuple[float, float]:
    """Make two numbers in [0, 1) of the stream that a seed and a key name."""
    text = "\0".join((str(seed), *key)).encode()
    digest = hashlib.blake2b(text, digest_size=16).digest()
    first, second = (int.from_bytes(part, "little") >> 11 for part in (digest[:8], digest[8:]))
    return first / (1 << 53), second / (1 << 53)


def resolve_draws(value: PlainValue, seed: int, path: str, robot: str = "") -> PlainValue:
    """Replace every draw in plain values by its number.

    Args:
        value: Lists and maps of scalars and draws.
        seed: Of the run.
        path: Key path of the value; entries of lists are addressed by name, else by index.
        robot: The robot that the value is for; empty = the whole run.
    """
    if isinstance(value, Draw):
        return value.draw(seed, path, robot)
    if isinstance(value, dict):
        return {
            key: resolve_draws(one, seed, f"{path}.{key}", robot)
            if isinstance(one, MAY_HAVE_DRAWS)
            else one
            for key, one in value.items()
        }
    if isinstance(value, list):
        return [
            resolve_draws(one, seed, _extend_path(path, one, index), robot)
            if isinstance(one, MAY_HAVE_DRAWS)
            else one
            for index, one in enumerate(value)
        ]
    return value


def _extend_path(path: str, entry: PlainValue, index: int) -> str:
    name = entry.get("name") if isinstance(entry, dict) else None
    return f"{path}.{name}" if name else f"{path}[{index}]"

"""A hostile input, and XML parts to build it from."""

from dataclasses import dataclass

ZERO = "0 0 0"
MASS = '<mass value="1"/>'
INERTIA = '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'
BODY = f"<inertial>{MASS}{INERTIA}</inertial>"
NO_NUMBERS = {
    "nan": "nan",
    "infinite": "inf",
    "minus_infinite": "-Infinity",
    "empty": "",
    "hexadecimal": "0x10",
    "comma": "1,5",
    "word": "one",
    "too_large": "1e309",
    "many_digits": "1" * 5000,
    "arabic_digits": "\u0663",
    "underscore": "1_000",
    "nul_escape": "1\\0",
    "expression": "1+1",
    "two_points": "1.2.3",
}
"""Texts that are not finite numbers."""


@dataclass(frozen=True)
class Case:
    """A hostile description.

    Attributes:
        slug: Slug of the refusal; empty if the input must be accepted.
    """

    name: str
    text: str
    slug: str


def robot(*parts: str) -> str:
    return f'<robot name="r">{"".join(parts)}</robot>'


def link(name: str, inside: str = BODY) -> str:
    return f'<link name="{name}">{inside}</link>'


def joint(name: str, parent: str, child: str, kind: str = "continuous", inside: str = "") -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f"{inside}</joint>"
    )


def solid(inside: str, part: str = "collision", origin: str = "") -> str:
    return f"<{part}>{origin}<geometry>{inside}</geometry></{part}>"


def pair(inside: str = "", kind: str = "continuous") -> str:
    """Make two links and a joint with additional content."""
    return robot(link("a"), link("b"), joint("j", "a", "b", kind, inside))


def alone(inside: str) -> str:
    """Make one link with additional content."""
    return robot(link("a", inside))

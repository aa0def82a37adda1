"""Colours of robots."""

import math
from itertools import combinations

import pytest

from zensim.spawner.page.robot_colours import ROBOT_COLOURS, Rgb, find_robot_colour

LEAST_DIFFERENCE = 28.0
"""Euclidean distance in sRGB of 0 to 255, after simulation of the deficiency."""
DEFICIENCIES = {
    "protanopia": ((0.152, 1.053, -0.205), (0.115, 0.786, 0.099), (-0.004, -0.048, 1.052)),
    "deuteranopia": ((0.367, 0.861, -0.228), (0.280, 0.673, 0.047), (-0.012, 0.043, 0.969)),
    "tritanopia": ((1.256, -0.077, -0.179), (-0.078, 0.931, 0.148), (0.005, 0.691, 0.304)),
}
"""Matrices of Machado, Oliveira and Fernandes (2009) at full severity, for linear RGB."""


def test_neighbours_in_a_row_have_different_colours() -> None:
    colours = [find_robot_colour(f"box_bot{i}") for i in range(100)]

    assert all(
        len(set(colours[i : i + len(ROBOT_COLOURS)])) == len(ROBOT_COLOURS) for i in range(90)
    )


@pytest.mark.parametrize("name", ["r1", "cart", "a/b/c7", "x" * 200, "9" * 200, "", "r1²"])
def test_a_name_has_one_colour(name: str) -> None:
    assert find_robot_colour(name) == find_robot_colour(name)
    assert find_robot_colour(name) in ROBOT_COLOURS


@pytest.mark.parametrize("deficiency", DEFICIENCIES)
def test_colours_differ_for_colour_blind_eyes(deficiency: str) -> None:
    seen = [simulate(colour, deficiency) for colour in ROBOT_COLOURS]

    least = min(math.dist(one, other) for one, other in combinations(seen, 2))

    assert least > LEAST_DIFFERENCE


def simulate(colour: Rgb, deficiency: str) -> tuple[float, ...]:
    """Simulate how a colour appears with a deficiency."""
    linear = [(channel / 255.0) ** 2.2 for channel in colour]
    mixed = (
        sum(weight * channel for weight, channel in zip(row, linear, strict=True))
        for row in DEFICIENCIES[deficiency]
    )
    return tuple(255.0 * min(max(channel, 0.0), 1.0) ** (1 / 2.2) for channel in mixed)

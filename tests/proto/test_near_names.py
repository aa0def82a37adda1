"""Names that are given instead of a mistyped one."""

import pytest

from zensim.proto.near_names import MOST_COMPARED, list_near, name_choices

NAMES = [f"box_bot{number}" for number in range(8)]


@pytest.mark.parametrize(
    ("given", "found"), [("r1/odmo", ["r1/odom"]), ("box_bto", []), ("", []), ("\x1b]0;", [])]
)
def test_near_names_resemble_the_given_one(given: str, found: list[str]) -> None:
    assert list_near(given, ["r1/odom", "r1/scan"])[:1] == found


def test_choices_begin_with_near_names_and_count_the_rest() -> None:
    assert (
        name_choices("lidra", [*NAMES, "lidar"], most=3) == "lidar, box_bot0, box_bot1 and 6 more"
    )


def test_there_are_no_choices_without_names() -> None:
    assert name_choices("r1", []) == ""


def test_only_the_first_names_of_many_are_compared() -> None:
    many = [*(str(number) for number in range(MOST_COMPARED)), "lidar"]

    assert list_near("lidra", many) == []

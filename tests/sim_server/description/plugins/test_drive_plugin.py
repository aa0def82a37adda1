"""Contradictions between a drive and the links are reported."""

import pytest

from tests.sim_server.description.robots import (
    FRAME,
    a_cart,
    a_drive,
    a_joint,
    a_link,
    assert_only_fault,
    suspicious,
)


def test_report_is_empty_when_drive_and_links_agree() -> None:
    assert suspicious(a_cart(a_drive())) == []


def test_base_frame_may_be_a_frame_that_is_fixed_to_the_root() -> None:
    foot = a_link("foot") + a_joint("f", ("base", "foot"))

    assert suspicious(a_cart(foot, a_drive(frame=FRAME.replace("base<", "foot<")))) == []


@pytest.mark.parametrize("frame", ["ghost", "left"])
def test_base_frame_is_reported_when_it_is_not_fixed_to_the_root(frame: str) -> None:
    text = a_cart(a_drive(frame=FRAME.replace("base<", f"{frame}<")))

    assert_only_fault(text, f"robot_base_frame '{frame}'", "'base'")

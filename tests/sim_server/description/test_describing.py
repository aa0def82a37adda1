"""A text and its meshes to a model, as the spawn asks for it."""

import pytest

from tests.sim_server.description.robots import a_cart, a_drive, a_link, a_robot, an_inertial
from zensim.proto.messages.drive_messages import Compat
from zensim.sim_server.description.describing import describe

COMPATS: tuple[Compat, ...] = ("fixed", "gazebo11")


@pytest.mark.parametrize("compat", COMPATS)
def test_drive_is_as_compatible_as_the_spawn_asks(compat: Compat) -> None:
    drive = describe(a_cart(a_drive()), assets={}, allow_missing=False, compat=compat).model.drive

    assert drive is not None
    assert drive.compat == compat


def test_robot_without_a_drive_is_the_same_whatever_the_spawn_asks() -> None:
    text = a_robot(a_link("base", an_inertial()))

    fixed, as_gazebo = (
        describe(text, assets={}, allow_missing=False, compat=compat).model for compat in COMPATS
    )

    assert fixed == as_gazebo

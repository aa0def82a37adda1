"""Collisions are found by each name that Gazebo gives them."""

import pytest

from zensim.proto.messages.model_messages import Frame, Link, Model, Shape
from zensim.sim_server.description.collision_names import (
    find_collisions,
    find_collisions_of_link,
    name_collision,
    name_merged,
)


def ball(name: str) -> Shape:
    return Shape("sphere", (0.1, 0.0, 0.0), name=name)


def merged(link: str, number: int = 0) -> Shape:
    return ball(name_merged("base", link, name_collision(link, number)))


MODEL = Model(
    "r",
    links=(
        Link("base", collisions=(ball("base_collision"), merged("ring"), merged("ring", 1),
                                 merged("ring_2"),
                             ball(name_merged("base", "ring", "rim_collision")))),
        Link("wheel", collisions=(ball("rubber"), ball("wheel_collision_1"))),
    ),
    frames=(Frame("ring", "base"), Frame("ring_2", "base"), Frame("bare", "base")),
)  # fmt: skip


@pytest.mark.parametrize(
    ("name", "found"),
    [
        ("base", ((0, 0),)),
        ("base_collision", ((0, 0),)),
        ("base::base_collision", ((0, 0),)),
        ("wheel", ((1, 0), (1, 1))),
        ("rubber", ((1, 0),)),
        ("wheel_collision_1", ((1, 1),)),
        ("wheel_collision", ((1, 0), (1, 1))),
        ("ring", ((0, 1), (0, 2), (0, 4))),
        ("ring_collision", ((0, 1),)),
        ("ring_collision_1", ((0, 2),)),
        ("ring_2_collision", ((0, 3),)),
        ("ring_2", ((0, 3),)),
        ("base_fixed_joint_lump__ring_collision", ((0, 1),)),
        ("base_fixed_joint_lump__ring_collision_1", ((0, 2),)),
        ("base_fixed_joint_lump__ring_2_collision_3", ((0, 3),)),
        ("r::base::base_fixed_joint_lump__ring_collision", ((0, 1),)),
        ("other_fixed_joint_lump__ring_collision", ((0, 1),)),
        ("base_collision_ring", ((0, 1), (0, 2), (0, 4))),
        ("base_geom", ((0, 0),)),
        ("base_fixed_joint_lump__rim_collision", ((0, 4),)),
        ("moon", ()),
        ("", ()),
        ("bare", ()),
    ],
)
def test_collisions_are_found(name: str, found: tuple[tuple[int, int], ...]) -> None:
    assert find_collisions(MODEL, name) == found


def test_collisions_of_a_link_are_its_own() -> None:
    assert find_collisions_of_link(MODEL, "base") == ((0, 0),)
    assert find_collisions_of_link(MODEL, "ring") == ((0, 1), (0, 2), (0, 4))
    assert find_collisions_of_link(MODEL, "moon") == ()

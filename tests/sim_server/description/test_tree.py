"""Links and joints make one tree, or the robot is refused."""

import pytest

from tests.sim_server.description.robots import a_joint, a_link, a_robot, an_inertial, link_names
from zensim.sim_server.description.tree import MAX_LINKS
from zensim.sim_server.description.urdf import read_urdf
from zensim.sim_server.errors import ModelError


def links(*names: str) -> str:
    return "".join(a_link(name, an_inertial()) for name in names)


@pytest.mark.parametrize(
    ("text", "slug", "named"),
    [
        (a_robot(), "urdf.no_links", "no links"),
        (a_robot(links("a", "b")), "urdf.two_roots", "'a', 'b'"),
        (a_robot(links("a", "a")), "urdf.duplicate_link", "'a'"),
        (
            a_robot(links("a", "b", "c"), a_joint("j", ("a", "b")), a_joint("j", ("a", "c"))),
            "urdf.duplicate_joint",
            "'j'",
        ),
        (a_robot(links("a"), a_joint("j", ("z", "a"))), "urdf.unknown_parent", "'z'"),
        (a_robot(links("a"), a_joint("j", ("a", "z"))), "urdf.unknown_child", "'z'"),
        (a_robot(links("a"), a_joint("j", ("a", "a"))), "urdf.cycle", "'a'"),
        (
            a_robot(links("a", "b"), a_joint("j", ("a", "b")), a_joint("k", ("b", "a"))),
            "urdf.cycle",
            "cycle",
        ),
        (
            a_robot(links("a", "b", "c"), a_joint("j", ("b", "c")), a_joint("k", ("c", "b"))),
            "urdf.cycle",
            "'b', 'c'",
        ),
        (
            a_robot(links("a", "b", "c"), a_joint("j", ("a", "c")), a_joint("k", ("b", "c"))),
            "urdf.two_parents",
            "'c'",
        ),
    ],
)
def test_tree_is_refused_when_it_is_none(text: str, slug: str, named: str) -> None:
    with pytest.raises(ModelError, match=named) as caught:
        read_urdf(text)

    assert caught.value.slug == slug


def test_tree_is_refused_when_it_is_huge() -> None:
    names = [f"l{i}" for i in range(MAX_LINKS + 1)]

    with pytest.raises(ModelError) as caught:
        read_urdf(a_robot(links(*names)))

    assert caught.value.slug == "urdf.size"
    assert len(caught.value.message) < 200


def test_tree_names_only_some_links_when_many_are_roots() -> None:
    with pytest.raises(ModelError, match="and 3 more are all roots"):
        read_urdf(a_robot(links(*"abcdefgh")))


def test_tree_has_parents_first_when_the_file_lists_them_last() -> None:
    joints = (
        a_joint("to_leaf", ("middle", "leaf"), "continuous"),
        a_joint("to_other", ("root", "other"), "continuous"),
        a_joint("to_middle", ("root", "middle"), "continuous"),
    )

    model = read_urdf(a_robot(links("leaf", "other", "middle", "root"), *joints))

    assert link_names(model) == ["root", "other", "middle", "leaf"]
    assert [joint.child for joint in model.joints] == ["other", "middle", "leaf"]

"""URDF is read as yourdfpy reads it, and differences are found."""

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from zensim.proto.messages.model_messages import Model, Origin
from zensim.sim_server.description.builtin_models import list_builtin_models, read_builtin_model
from zensim.sim_server.description.urdf.independent_reading import find_reading_differences
from zensim.sim_server.description.urdf.urdf_parser import read_urdf

NUMBERS = st.floats(-3.0, 3.0).map(lambda number: round(number, 3))
KINDS = st.sampled_from(["fixed", "continuous", "revolute", "prismatic"])
JOINTS = st.tuples(st.integers(0, 99), KINDS, st.tuples(*[NUMBERS] * 6), st.floats(0.01, 50.0))


def make_tree(joints: list[tuple[int, str, tuple[float, ...], float]]) -> str:
    """Make a robot: each joint adds a link to an earlier one."""
    parts = ['<link name="l0"/>']
    for child, (above, kind, numbers, mass) in enumerate(joints, start=1):
        x, y, z, roll, pitch, yaw = numbers
        pose = f'<origin xyz="{x} {y} {z}" rpy="{roll} {pitch} {yaw}"/>'
        parts.append(
            f'<link name="l{child}"><inertial>{pose}<mass value="{mass}"/><inertia ixx="1" iyy="1" '
            f'izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="j{child}" type="{kind}">{pose}<parent link="l{above % child}"/>'
            f'<child link="l{child}"/><axis xyz="0 0 1"/>'
            '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
        )
    return f'<robot name="tree">{"".join(parts)}</robot>'


def replace_first_joint(model: Model, **fields: object) -> Model:
    joint = msgspec.structs.replace(model.joints[0], **fields)
    return msgspec.structs.replace(model, joints=(joint, *model.joints[1:]))


@pytest.mark.parametrize("name", list_builtin_models())
def test_built_in_robot_is_read_alike(name: str) -> None:
    text = read_builtin_model(name)

    assert find_reading_differences(text, read_urdf(text)) == ()


@settings(max_examples=settings().max_examples // 4)
@given(st.lists(JOINTS, min_size=1, max_size=8))
def test_tree_is_read_alike(joints: list[tuple[int, str, tuple[float, ...], float]]) -> None:
    text = make_tree(joints)

    assert find_reading_differences(text, read_urdf(text)) == ()


def test_difference_of_pose_mass_and_links_is_found() -> None:
    text = make_tree([(0, "continuous", (1.0, 0.0, 0.0, 0.0, 0.0, 0.5), 2.0)] * 2)
    model = read_urdf(text)
    turned = replace_first_joint(model, origin=Origin((1.0, 0.0, 0.0)))
    shorter = msgspec.structs.replace(model, links=model.links[:2], joints=model.joints[:1])

    assert "l1" in find_reading_differences(text, turned)[0]
    assert len(find_reading_differences(text, shorter)) == 2


def test_text_that_only_one_can_read_is_a_difference() -> None:
    model = read_urdf('<robot name="a"><link name="b"/></robot>')

    assert len(find_reading_differences("<robot", model)) == 1

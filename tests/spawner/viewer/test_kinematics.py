import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from zensim.proto.messages.model_messages import JointKind, Origin
from zensim.proto.rotation import from_rpy
from zensim.spawner.viewer.kinematics import Hinge, link_poses

METRES = st.floats(-3.0, 3.0)
RADIANS = st.floats(-3.0, 3.0)
VECTORS = st.tuples(METRES, METRES, METRES)
TURNS = st.tuples(RADIANS, RADIANS, RADIANS)
AXES = VECTORS.filter(lambda axis: np.linalg.norm(axis) > 0.1)
KIND_NAMES: tuple[JointKind, ...] = ("revolute", "continuous", "prismatic", "fixed")
KINDS = st.sampled_from(KIND_NAMES)
REST = np.array((0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0))


@st.composite
def trees(draw: st.DrawFn) -> tuple[Hinge, ...]:
    return tuple(
        Hinge(
            draw(KINDS),
            draw(st.integers(0, number)),
            Origin(draw(VECTORS), tuple(from_rpy(*draw(TURNS)))),
            draw(AXES),
        )
        for number in range(draw(st.integers(1, 5)))
    )


def matrix_of(position: np.ndarray, quaternion: np.ndarray) -> np.ndarray:
    x, y, z, w = quaternion
    matrix = np.eye(4)
    matrix[:3, 3] = position
    matrix[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return matrix


def motion_of(kind: JointKind, axis: np.ndarray, moved: float) -> np.ndarray:
    """Rodrigues' formula, or a shift along the axis."""
    matrix, (x, y, z) = np.eye(4), axis / np.linalg.norm(axis)
    if kind == "prismatic":
        matrix[:3, 3] = moved * np.array((x, y, z))
    elif kind != "fixed":
        skew = np.array(((0, -z, y), (z, 0, -x), (-y, x, 0)))
        matrix[:3, :3] += np.sin(moved) * skew + (1 - np.cos(moved)) * skew @ skew
    return matrix


def matrices_of(
    hinges: tuple[Hinge, ...], base: np.ndarray, joints: np.ndarray
) -> list[np.ndarray]:
    placed = [matrix_of(base[:3], base[3:])]
    for hinge, moved in zip(hinges, joints, strict=True):
        origin = matrix_of(np.array(hinge.origin.position), np.array(hinge.origin.orientation))
        motion = motion_of(hinge.kind, np.array(hinge.axis), moved)
        placed.append(placed[hinge.parent] @ origin @ motion)
    return placed


@given(hinges=trees(), data=st.data(), count=st.integers(1, 3))
def test_links_of_all_entities_are_where_matrices_put_each(
    hinges: tuple[Hinge, ...], data: st.DataObject, count: int
) -> None:
    base = np.array(
        [[*data.draw(VECTORS), *from_rpy(*data.draw(TURNS))] for _ in range(count)], dtype=float
    )
    joints = np.array([[data.draw(RADIANS) for _ in hinges] for _ in range(count)])

    links = link_poses(hinges, base, joints)

    for entity in range(count):
        expected = matrices_of(hinges, base[entity], joints[entity])
        for pose, matrix in zip(links, expected, strict=True):
            found = matrix_of(pose.positions[entity], pose.quaternions[entity])
            np.testing.assert_allclose(found, matrix, atol=1e-9)


def test_wheel_turns_about_its_axis_when_its_joint_moves() -> None:
    hinge = Hinge("continuous", 0, Origin((0.0, 0.05, 0.0)), (0.0, 2.0, 0.0))

    _, wheel = link_poses((hinge,), REST[None], np.array([[np.pi / 2.0]]))

    assert wheel.positions[0] == pytest.approx((0.0, 0.05, 0.0))
    assert wheel.wxyzs[0] == pytest.approx((np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0))


def test_base_alone_is_where_it_is_when_nothing_is_hinged() -> None:
    (base,) = link_poses((), REST[None] + 1.0, np.zeros((1, 0)))

    assert base.positions.tolist() == [[1.0, 1.0, 1.0]]

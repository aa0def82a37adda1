"""Motion of links: what kinematics says is what physics does."""

import math

import numpy as np
import pytest

from tests.models import a_body, a_cart, a_state, an_arm
from zensim.proto.forward_kinematics import compute_link_poses, compute_link_states
from zensim.proto.messages.model_messages import Frame, Joint, JointKind, Link, Model, Origin
from zensim.proto.se3 import FloatArray, compose, from_rpy, multiply, rotate

HERE = a_state()[:7]


def pose(*place: float, yaw: float = 0.0) -> FloatArray:
    return np.concatenate([place, from_rpy(0.0, 0.0, yaw)])


@pytest.mark.parametrize(
    ("kind", "position", "tip"),
    [
        ("prismatic", 0.25, (0.2, 0.0, 1.25)),
        ("continuous", math.pi / 2.0, (0.0, 0.0, 0.8)),
        ("revolute", -math.pi / 2.0, (0.0, 0.0, 1.2)),
        ("fixed", 0.3, (0.2, 0.0, 1.0)),
    ],
)
def test_joint_moves_its_child(
    kind: JointKind, position: float, tip: tuple[float, float, float]
) -> None:
    poses = compute_link_poses(an_arm(kind), HERE[None], np.array([[position]]))

    found = compose(poses["arm"], pose(0.2, 0.0, 0.0))

    assert found[0, :3] == pytest.approx(tip)


def test_links_of_many_entities_are_found_at_once() -> None:
    bases = np.array([pose(0.0, 0.0, 0.0), pose(5.0, 1.0, 0.0, yaw=math.pi / 2.0)])

    poses = compute_link_poses(a_cart(), bases, np.zeros((2, 2)))

    assert poses["left"][0, :3] == pytest.approx([0.0, 0.15, 0.0])
    assert poses["left"][1, :3] == pytest.approx([4.85, 1.0, 0.0])


def test_frames_that_were_merged_are_found_too() -> None:
    model = Model(
        "r", a_cart().links[:1], frames=(Frame("lidar", "base", Origin((0.1, 0.0, 0.2))),)
    )

    poses = compute_link_poses(model, pose(1.0, 0.0, 0.0, yaw=math.pi)[None], np.zeros((1, 0)))

    assert poses["lidar"][0, :3] == pytest.approx([0.9, 0.0, 0.2])


DT_S = 1e-6


def a_chain() -> Model:
    """A root, a turning link, a sliding link on it, and a frame merged into that."""
    turn = Joint("turn", "continuous", "base", "arm", Origin((0.5, 0.1, 0.2)), axis=(0.0, 0.6, 0.8))
    slide = Joint(
        "slide",
        "prismatic",
        "arm",
        "hand",
        Origin((0.3, 0.0, 0.1), (0.0, 0.0, 0.6, 0.8)),
        axis=(0.0, 1.0, 0.0),
        lower=-1.0,
        upper=1.0,
    )
    links = tuple(Link(name, a_body()) for name in ("base", "arm", "hand"))
    frames = (Frame("tip", "hand", Origin((0.0, 0.2, 0.0))),)
    return Model("chain", links, (turn, slide), frames)


BASE = a_state(
    (1.0, 2.0, 3.0), turn=(0.3, -0.2, 0.9), linear=(0.4, -0.1, 0.2), angular=(0.5, 0.7, -0.3)
)
POSITIONS, VELOCITIES = np.array([[0.4, 0.25]]), np.array([[1.3, -0.6]])


def moved(base: FloatArray) -> FloatArray:
    """Move a root on by a moment."""
    found = base.copy()
    found[:3] += base[7:10] * DT_S
    spin = np.append(base[10:13] * DT_S / 2.0, 1.0)
    found[3:7] = multiply(spin / np.linalg.norm(spin), base[3:7])
    return np.asarray(found)


@pytest.mark.parametrize("name", ["base", "arm", "hand", "tip"])
def test_link_moves_as_its_poses_do(name: str) -> None:
    model = a_chain()
    row = compute_link_states(model, BASE[None], POSITIONS, VELOCITIES)[name][0]
    here = compute_link_poses(model, BASE[None, :7], POSITIONS)[name][0]
    there = compute_link_poses(model, moved(BASE)[None, :7], POSITIONS + VELOCITIES * DT_S)[name][0]

    assert row[:7] == pytest.approx(here)
    assert row[7:10] == pytest.approx((there[:3] - here[:3]) / DT_S, abs=1e-5)
    for axis in np.eye(3):
        drift = (rotate(there[3:], axis) - rotate(here[3:], axis)) / DT_S
        assert np.cross(row[10:], rotate(here[3:], axis)) == pytest.approx(drift, abs=1e-5)


def test_links_of_many_entities_are_those_of_each() -> None:
    model = a_chain()
    other = a_state((-1.0, 0.0, 0.5), linear=(1.0, 0.0, 0.0))
    many = compute_link_states(
        model,
        np.stack([BASE, other]),
        np.concatenate([POSITIONS, -POSITIONS]),
        np.concatenate([VELOCITIES, -VELOCITIES]),
    )
    alone = compute_link_states(model, other[None], -POSITIONS, -VELOCITIES)

    for name, rows in many.items():
        assert rows[1] == pytest.approx(alone[name][0])

"""Motion of links: what kinematics says is what physics does."""

import numpy as np
import pytest

from tests.models import a_body, a_state
from zensim.proto.messages.model_messages import Frame, Joint, Link, Model, Origin
from zensim.proto.rotation import FloatArray, multiply, rotate
from zensim.sim_server.geometry.kinematics import link_poses
from zensim.sim_server.geometry.motions import link_states

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
    row = link_states(model, BASE[None], POSITIONS, VELOCITIES)[name][0]
    here = link_poses(model, BASE[None, :7], POSITIONS)[name][0]
    there = link_poses(model, moved(BASE)[None, :7], POSITIONS + VELOCITIES * DT_S)[name][0]

    assert row[:7] == pytest.approx(here)
    assert row[7:10] == pytest.approx((there[:3] - here[:3]) / DT_S, abs=1e-5)
    for axis in np.eye(3):
        drift = (rotate(there[3:], axis) - rotate(here[3:], axis)) / DT_S
        assert np.cross(row[10:], rotate(here[3:], axis)) == pytest.approx(drift, abs=1e-5)


def test_links_of_many_entities_are_those_of_each() -> None:
    model = a_chain()
    other = a_state((-1.0, 0.0, 0.5), linear=(1.0, 0.0, 0.0))
    many = link_states(
        model,
        np.stack([BASE, other]),
        np.concatenate([POSITIONS, -POSITIONS]),
        np.concatenate([VELOCITIES, -VELOCITIES]),
    )
    alone = link_states(model, other[None], -POSITIONS, -VELOCITIES)

    for name, rows in many.items():
        assert rows[1] == pytest.approx(alone[name][0])

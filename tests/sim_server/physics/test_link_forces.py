"""Gravity compensation and damping of links."""

import math

import numpy as np
import pytest

from tests.models import a_body
from zensim.proto.messages.model_messages import Decay, Inertial, Joint, Link, Model, Shape, Vec3
from zensim.proto.se3 import from_rpy
from zensim.sim_server.physics.blueprint import make_blueprint
from zensim.sim_server.physics.link_forces import LinkForce, explicit_decay_rate, make_link_forces

G: Vec3 = (0.0, 0.0, -10.0)
DT_S = 0.004
UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])
LOPSIDED = Inertial(2.0, (0.3, -0.2, 0.1), (0.05, 0.01, -0.008, 0.07, 0.006, 0.09))


def loads(*links: Link, is_static: bool = False) -> list[LinkForce]:
    joints = tuple(
        Joint(f"j{i}", "continuous", links[0].name, link.name) for i, link in enumerate(links[1:])
    )
    return make_link_forces(make_blueprint(Model("m", links, joints, is_static=is_static)), G, DT_S)


def test_plain_links_have_no_forces() -> None:
    assert loads(Link("a", a_body()), Link("b", a_body())) == []


def test_weightless_link_is_compensated_at_its_centre() -> None:
    (load,) = loads(Link("a", LOPSIDED, weightless=LOPSIDED))

    force, torque = load.wrench(UPRIGHT, np.ones(6))

    assert load.part == -1
    assert force == pytest.approx([0.0, 0.0, 20.0])
    assert torque == pytest.approx([0.0] * 3)


def test_weightless_share_of_a_link_is_compensated_at_its_own_centre() -> None:
    light = Inertial(0.5, (1.3, -0.2, 0.1))
    (load,) = loads(Link("a", LOPSIDED, weightless=light))
    principal = np.array(make_blueprint(Model("m", (Link("a", LOPSIDED),))).parts[0].principal)

    force, torque = load.wrench(principal, np.zeros(6))

    assert force == pytest.approx([0.0, 0.0, 5.0])
    assert torque == pytest.approx([0.0, -5.0, 0.0])


def test_damping_of_a_link_scales_with_mass_and_inertia() -> None:
    _, load = loads(
        Link("a", a_body(), decay=Decay(1.0, 1.0)), Link("b", LOPSIDED, decay=Decay(2.0, 3.0))
    )
    turn = from_rpy(0.3, 0.2, 0.1)
    principal = np.array(make_blueprint(Model("m", (Link("b", LOPSIDED),))).parts[0].principal)

    force, _ = load.wrench(turn, np.array([1.0, 2.0, 3.0, 0.0, 0.0, 0.0]))
    _, torque = load.wrench(principal, np.array([0.0, 0.0, 0.0, 1.0, 0.5, -0.5]))

    matrix = np.array([[0.05, 0.01, -0.008], [0.01, 0.07, 0.006], [-0.008, 0.006, 0.09]])
    assert load.part == 0
    assert force == pytest.approx(-2.0 * explicit_decay_rate(2.0, DT_S) * np.array([1.0, 2.0, 3.0]))
    assert torque == pytest.approx(-explicit_decay_rate(3.0, DT_S) * matrix @ [1.0, 0.5, -0.5])


def test_fixed_root_has_no_forces() -> None:
    root = Link("a", a_body(), weightless=a_body())
    arm = Link("b", a_body(), (Shape("sphere", (0.1, 0.0, 0.0)),), weightless=a_body())

    assert [load.part for load in loads(root, arm, is_static=True)] == [0]


@pytest.mark.parametrize("rate", [0.0, 0.5, 10.0, 1e4])
def test_explicit_rate_decays_as_much_as_the_exponential(rate: float) -> None:
    assert 1.0 - explicit_decay_rate(rate, DT_S) * DT_S == pytest.approx(math.exp(-rate * DT_S))

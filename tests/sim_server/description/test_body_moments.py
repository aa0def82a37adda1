"""Moments that a body can have, and those with which a loose one rests."""

import numpy as np
import pytest

from zensim.proto.messages.model_messages import Inertial, Link, Origin, Shape
from zensim.sim_server.description.body_moments import (
    LEAST_SHARE,
    find_nearest_moments,
    raise_light_moments,
    to_inertia_matrix,
)
from zensim.sim_server.description.model_geometry import NO_MESHES
from zensim.sim_server.description.pipeline import parse_description

SIDE_M = 0.3
MASS_KG = 5.0
OWN = MASS_KG * SIDE_M**2 / 6.0
"""Moment of a solid cube [kg m^2]."""


def a_cube(share: float) -> Link:
    moment = share * OWN
    inertia = (moment, 0.0, 0.0, moment, 0.0, moment)
    return Link("cube", Inertial(MASS_KG, inertia=inertia), (Shape("box", (SIDE_M,) * 3),))


@pytest.mark.parametrize("seed", range(20))
def test_nearest_moments_are_nearer_than_any_others_that_a_body_has(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b, c, d, e, f = rng.normal(size=6).tolist()
    written = to_inertia_matrix((a, b, c, d, e, f))

    nearest = to_inertia_matrix(find_nearest_moments((a, b, c, d, e, f)))

    least, middle, most = np.linalg.eigvalsh(nearest)
    assert least > -1e-12
    assert least + middle > most - 1e-12
    # Those of masses at random places.
    for _ in range(200):
        places = rng.normal(size=(3, 3)) * rng.uniform(0.0, 1.0)
        other = np.eye(3) * (places**2).sum() - places.T @ places
        assert np.linalg.norm(nearest - written) <= np.linalg.norm(other - written) + 1e-12


def test_possible_moments_are_their_own_nearest() -> None:
    inertia = (0.5, 0.1, 0.0, 0.6, 0.05, 0.7)

    assert find_nearest_moments(inertia) == pytest.approx(inertia)


@pytest.mark.parametrize("share", [1e-3, 0.1, 0.2])
def test_loose_body_has_a_least_share_of_the_moments_around_its_collisions(share: float) -> None:
    raised = raise_light_moments(a_cube(share), NO_MESHES)

    assert raised is not None
    ixx, _, _, iyy, _, izz = raised.inertia
    assert (ixx, iyy, izz) == pytest.approx((LEAST_SHARE * OWN,) * 3)


def test_larger_moments_stay() -> None:
    assert raise_light_moments(a_cube(0.3), NO_MESHES) is None


@pytest.mark.parametrize("kind", ["sphere", "cylinder", "capsule"])
def test_solid_of_uniform_density_is_not_changed(kind: str) -> None:
    radius, length, mass = 0.1, 0.5, 2.0
    shape = Shape(kind, (radius, length, 0.0), Origin((0.1, 0.0, 0.0)))  # type: ignore[arg-type]
    across = 0.4 * mass * radius**2
    if kind != "sphere":
        across = mass * (3.0 * radius**2 + length**2) / 12.0
    inertial = Inertial(mass, (0.1, 0.0, 0.0), (across, 0, 0, across, 0, 0.4 * mass * radius**2))

    assert raise_light_moments(Link("solid", inertial, (shape,)), NO_MESHES) is None


ARM = """<robot name="arm"><link name="base"><inertial><mass value="5"/>{moments}</inertial>
{box}</link><link name="tip"><inertial><mass value="1"/>{tip}</inertial>{box}</link>
<joint name="j" type="revolute"><parent link="base"/><child link="tip"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""
A_BOX = '<collision><geometry><box size="0.3 0.3 0.3"/></geometry></collision>'
SMALL, NONE = (f'<inertia ixx="{one}" iyy="{one}" izz="{one}"/>' for one in ("1e-4", "0"))


@pytest.mark.parametrize(("tip", "is_raised"), [(NONE, True), (SMALL, False)])
def test_only_a_link_on_a_joint_without_any_moments_gets_some(tip: str, *, is_raised: bool) -> None:
    text = ARM.format(moments=SMALL, tip=tip, box=A_BOX)

    model = parse_description(text, assets={}, allow_missing=False, compat="fixed").model

    predicted = [entry.subject for entry in model.report if entry.status == "predicted"]
    assert ("link 'tip'" in predicted) is is_raised
    assert (model.links[1].inertial.inertia[0] > 1e-3) is is_raised
    assert model.links[0].inertial.inertia[0] == pytest.approx(1e-4)


def test_report_predicts_what_is_changed() -> None:
    text = (
        '<robot name="crate"><link name="crate"><inertial><mass value="5"/>'
        '<inertia ixx="1e-4" iyy="1e-4" izz="1e-4"/></inertial><collision><geometry>'
        '<box size="0.3 0.3 0.3"/></geometry></collision></link></robot>'
    )

    model = parse_description(text, assets={}, allow_missing=False, compat="fixed").model

    predicted = [entry.subject for entry in model.report if entry.status == "predicted"]
    assert predicted == ["link 'crate'"]
    assert model.links[0].inertial.inertia[0] == pytest.approx(LEAST_SHARE * OWN)

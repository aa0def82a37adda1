import math

import msgspec
import numpy as np
import pytest

from tests.models import a_box, a_box_bot
from zensim.proto.messages.model_messages import Inertial, Joint, Link, Model, Origin, Shape
from zensim.sim_server.description.rest_pose import GRAVITY, RestPose, RestSolver

MOMENTS = (0.01, 0.0, 0.0, 0.01, 0.0, 0.01)


def rest_of(model: Model) -> RestPose:
    return RestSolver(model).solve(np.zeros(len(model.joints)))


def loads_by_place(rest: RestPose) -> dict[tuple[float, float], float]:
    places = np.round(rest.points[:, :2], 3).tolist()
    return {(x, y): load for (x, y), load in zip(places, rest.loads.tolist(), strict=True)}


def on_feet(*feet: tuple[float, float, float], com: tuple[float, float, float]) -> Model:
    """Make a body of 1 kg on balls whose lowest points are at these places."""
    balls = tuple(Shape("sphere", (0.02, 0.0, 0.0), Origin((x, y, z + 0.02))) for x, y, z in feet)
    return Model("stool", (Link("base", Inertial(1.0, com, MOMENTS), balls),))


def test_weight_is_shared_alike_by_the_corners_of_a_cube() -> None:
    rest = rest_of(a_box())

    assert rest.is_stable
    assert rest.loads == pytest.approx([GRAVITY / 4.0] * 4, rel=1e-4)
    assert rest.tilt_rad < 1e-4


def test_loads_on_three_feet_are_those_of_statics() -> None:
    rest = rest_of(on_feet((0.0, 0.2, 0.0), (0.0, -0.2, 0.0), (0.4, 0.0, 0.0), com=(0.1, 0.1, 0.3)))

    assert loads_by_place(rest) == pytest.approx(
        {(0.0, 0.2): 0.625 * GRAVITY, (0.0, -0.2): 0.125 * GRAVITY, (0.4, 0.0): 0.25 * GRAVITY},
        rel=1e-3,
    )


def test_loads_of_a_row_of_feet_grow_towards_the_centre_of_mass() -> None:
    feet = [(x, y, 0.0) for x in (-0.2, 0.0, 0.2) for y in (-0.1, 0.1)]

    rest = rest_of(on_feet(*feet, com=(0.05, 0.0, 0.1)))

    # Equal springs: load = weight / 6 + slope x, slope = moment / sum of x^2.
    slope = GRAVITY * 0.05 / (4 * 0.2**2)
    expected = {(x, y): GRAVITY / 6.0 + slope * x for x, y, _ in feet}
    assert loads_by_place(rest) == pytest.approx(expected, rel=1e-3)


def test_body_tilts_onto_a_foot_that_hangs_in_the_air() -> None:
    rest = rest_of(
        on_feet((0.0, 0.2, 0.0), (0.0, -0.2, 0.0), (0.3, 0.0, 0.03), com=(0.1, 0.0, 0.1))
    )

    assert rest.is_stable
    assert rest.tilt_rad == pytest.approx(math.atan2(0.03, 0.3), rel=0.03)
    assert len(rest.loads) == 3


def test_body_tips_over_where_its_centre_of_mass_is_outside_of_its_feet() -> None:
    feet = ((0.0, 0.2, 0.0), (0.0, -0.2, 0.0), (0.1, 0.0, 0.0))

    assert not rest_of(on_feet(*feet, com=(0.2, 0.0, 0.5))).is_stable


def test_model_without_collisions_has_no_contacts() -> None:
    rest = rest_of(Model("ghost", (Link("base", Inertial(1.0)),)))

    assert not rest.is_stable
    assert len(rest.loads) == 0


def test_box_bot_stands_on_its_wheels() -> None:
    model = a_box_bot()

    rest = rest_of(model)

    assert rest.loads.sum() == pytest.approx(GRAVITY * model.mass_kg, rel=1e-4)
    assert {model.links[link].name for link in rest.support.link.tolist()} == {
        "left_wheel",
        "right_wheel",
    }


def test_suspension_settles_on_its_spring() -> None:
    leg = Joint(
        "leg",
        "prismatic",
        "base",
        "foot",
        axis=(0.0, 0.0, 1.0),
        lower=-0.1,
        upper=0.1,
        spring_stiffness=1000.0,
    )
    balls = tuple(
        Shape("sphere", (0.02, 0.0, 0.0), Origin((0.1 * x, 0.1 * y, -0.1)))
        for x, y in ((1, 0), (-1, 1), (-1, -1))
    )
    body = Link("base", Inertial(2.0, (0.0, 0.0, 0.1), MOMENTS))
    model = Model("hopper", (body, Link("foot", Inertial(0.5, inertia=MOMENTS), balls)), (leg,))

    rest = rest_of(model)

    assert rest.positions == pytest.approx([2.0 * GRAVITY / 1000.0], rel=1e-3)
    assert rest.loads.sum() == pytest.approx(2.5 * GRAVITY, rel=1e-4)


def test_soft_foot_carries_less() -> None:
    model = on_feet((0.1, 0.1, 0), (0.1, -0.1, 0), (-0.1, 0.1, 0), (-0.1, -0.1, 0), com=(0, 0, 0.1))
    base = model.links[0]
    soft = tuple(
        msgspec.structs.replace(
            shape, contact=msgspec.structs.replace(shape.contact, stiffness=100.0)
        )
        if shape.origin.position[0] * shape.origin.position[1] > 0.0
        else shape
        for shape in base.collisions
    )
    softened = msgspec.structs.replace(
        model, links=(msgspec.structs.replace(base, collisions=soft),)
    )

    found = loads_by_place(rest_of(softened))

    assert found.get((0.1, 0.1), 0.0) < 0.01 * GRAVITY
    assert found[(0.1, -0.1)] == pytest.approx(GRAVITY / 2.0, rel=0.01)


def test_mesh_rests_on_its_scaled_corners() -> None:
    corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float32)
    crate = Shape("mesh", (0.3, 0.2, 0.1), mesh="crate")
    model = Model("crate", (Link("base", Inertial(1.0, (0.0, 0.0, 0.0), MOMENTS), (crate,)),))

    rest = RestSolver(model, lambda _: corners).solve(np.zeros(0))

    assert rest.is_stable
    assert sorted(np.round(rest.points[:, :2], 3).tolist()) == [
        [-0.3, -0.2],
        [-0.3, 0.2],
        [0.3, -0.2],
        [0.3, 0.2],
    ]
    assert rest.loads == pytest.approx([GRAVITY / 4.0] * 4, rel=1e-3)

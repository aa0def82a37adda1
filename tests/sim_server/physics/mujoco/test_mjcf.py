"""MJCF text of worlds with slots."""

from collections.abc import Sequence

import mujoco
import numpy as np
import pytest

from tests.engines import STEP_NS
from tests.models import a_box, a_box_bot
from tests.sim_server.physics.mujoco.test_convex_pieces import a_grid, a_room
from zensim.proto.messages.model_messages import Joint, Link, Model, Origin, Shape
from zensim.sim_server.physics.blueprint import make_blueprint
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.mujoco import mjcf
from zensim.sim_server.physics.mujoco.convex_pieces import HullPoints, split_into_convex_pieces
from zensim.sim_server.physics.mujoco.slot_layout import Archetype, make_archetype

CONFIG = EngineConfig(STEP_NS)
ARRAYS = (
    "body_parentid",
    "body_pos",
    "body_quat",
    "body_mass",
    "body_inertia",
    "body_gravcomp",
    "geom_bodyid",
    "geom_type",
    "geom_size",
    "geom_pos",
    "geom_quat",
    "geom_friction",
    "geom_priority",
    "geom_condim",
    "geom_solref",
    "geom_solimp",
    "geom_contype",
    "jnt_type",
    "jnt_axis",
    "dof_armature",
    "qpos0",
)


def load_pieces(shape: Shape, is_static: bool) -> Sequence[HullPoints]:  # noqa: FBT001
    """Find the pieces of the mesh that a shape names."""
    mesh = a_room() if shape.mesh == "room" else a_grid(lambda x, y: 0.2 * x * x + 0.1 * y, 8)
    return split_into_convex_pieces(mesh * np.array(shape.size), is_static=is_static)


def a_mesh(name: str, origin: Origin | None = None, friction: float = 1.0) -> Shape:
    """Make a shape of a mesh."""
    return Shape("mesh", (1.0, 1.0, 1.0), origin or Origin(), mesh=name, friction=friction)


def scenery() -> Archetype:
    """Make a static model of two links, with a concave mesh, a fine one, and a box."""
    turned = Origin((0.3, 0.0, 1.0), (0.0, 0.0, 0.6, 0.8))
    upper = Link("upper", collisions=(a_mesh("room", turned), Shape("box", (0.1, 0.2, 0.3))))
    return make_archetype(
        make_blueprint(
            Model(
                "scenery",
                (Link("lower", collisions=(a_mesh("slope"),)), upper),
                (Joint("fix", "fixed", "lower", "upper", Origin((0.0, 0.5, 0.0))),),
                is_static=True,
            )
        )
    )


def compile_slots(slots: Sequence[tuple[Archetype, int]]) -> mujoco.MjModel:
    """Compile slots."""
    return mujoco.MjModel.from_xml_string(*mjcf.write_mjcf(slots, CONFIG, load_pieces))


def test_large_scenery_is_compiled_as_if_it_were_not_a_model_of_its_own(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    box, robot = (make_archetype(make_blueprint(one)) for one in (a_box(), a_box_bot()))
    slots = [(box, 2), (scenery(), 3), (robot, 2)]
    monkeypatch.setattr(mjcf, "SCENERY_GEOMETRIES", 1000)
    alone = compile_slots(slots)
    monkeypatch.setattr(mjcf, "SCENERY_GEOMETRIES", 5)

    apart = compile_slots(slots)

    assert mjcf.write_mjcf(slots, CONFIG, load_pieces).files.keys() == {"s2.xml"}
    for name in ARRAYS:
        assert np.array_equal(getattr(apart, name), getattr(alone, name)), name
    assert apart.opt.timestep == alone.opt.timestep


def test_identical_meshes_are_one_asset() -> None:
    rooms = [
        a_mesh("room", Origin((x, 0.0, 0.0)), friction) for x, friction in ((0.0, 1.0), (5.0, 0.5))
    ]
    models = [
        Model(f"room{at}", (Link("room", collisions=(shape,)),), is_static=True)
        for at, shape in enumerate(rooms)
    ]

    found = compile_slots([(make_archetype(make_blueprint(model)), 1) for model in models])

    assert len(found.geom_bodyid) == 1 + 2 * 6
    assert len(set(found.geom_dataid.tolist()) - {-1}) == 6

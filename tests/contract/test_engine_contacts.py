"""Contract of `read_contacts`."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.engines import REAL_ENGINES, STEP_NS, MakeEngine, advance, running
from tests.models import a_body, a_box, a_box_bot, a_state, box_bot_at
from tests.sim_server.physics.mujoco.test_convex_pieces import a_cuboid
from zensim.proto.messages.model_messages import Inertial, Joint, Link, Model, Origin, Shape
from zensim.proto.stl import write_corners
from zensim.sim_server.physics.bullet.pybullet_engine import PyBulletEngine
from zensim.sim_server.physics.engine import GROUND, MAX_PENETRATION_RECOVERY_MPS, Engine
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.kinematic.tiered_engine import TieredEngine
from zensim.sim_server.physics.mujoco.mujoco_engine import MujocoEngine

WEIGHT_N = 9.81
SIDE_M = 0.2


@pytest.fixture(params=REAL_ENGINES, ids=lambda make: make.name)
def engine(request: pytest.FixtureRequest) -> Iterator[Engine]:
    with running(request.param) as made:
        yield made


def test_engine_tells_the_weight_of_a_resting_box(engine: Engine) -> None:
    box, other = (engine.add(a_box(), a_state((x, 0.0, SIDE_M / 2.0))) for x in (0.0, 3.0))
    advance(engine, 480)

    found = engine.read_contacts((box,))

    assert len(found) >= 1
    assert (found.bodies == [box, 0, GROUND, 0]).all()
    assert found.points[:, 7:].sum(axis=0) == pytest.approx([0.0, 0.0, WEIGHT_N], abs=0.05)
    assert found.points[:, 3:6] == pytest.approx(np.array([[0.0, 0.0, 1.0]] * len(found)), abs=1e-6)
    assert found.points[:, 2] == pytest.approx(np.zeros(len(found)), abs=2e-3)
    assert (np.abs(found.points[:, 6]) < 2e-3).all()
    assert set(engine.read_contacts((box, other)).bodies[:, 0].tolist()) == {box, other}


@pytest.mark.parametrize("step_ns", [STEP_NS, 1_000_000])
@pytest.mark.parametrize("make", [PyBulletEngine, MujocoEngine])
@pytest.mark.parametrize("is_static", [True, False])
def test_bodies_that_overlap_part_slowly(
    make: MakeEngine, step_ns: int, *, is_static: bool
) -> None:
    with running(make, EngineConfig(step_ns, gravity=(0.0, 0.0, -9.81))) as engine:
        wall = engine.add(a_box("wall", 1.0, is_static=is_static), a_state((0.0, 0.0, 0.5)))
        sofa = engine.add(a_box("sofa", 1.0), a_state((0.9, 0.0, 0.5)))
        assert engine.find_overlaps(sofa) == [wall]
        sunk = engine.add(a_box("sunk", 1.0), a_state((5.0, 0.0, 0.4)))
        assert engine.find_overlaps(sunk) == []
        bodies, fastest = (wall, sofa, sunk), 0.0
        for _ in range(2_000_000_000 // step_ns):
            advance(engine, 1)
            fastest = max(fastest, np.abs(engine.read(bodies).base[:, 7:10]).max())

        states = engine.read(bodies).base

    assert fastest < 1.5 * MAX_PENETRATION_RECOVERY_MPS
    assert states[1, 0] - states[0, 0] == pytest.approx(1.0, abs=0.01)
    assert states[2, 2] == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize("make", [PyBulletEngine, MujocoEngine])
def test_static_body_that_gets_a_velocity_has_none(make: MakeEngine) -> None:
    with running(make, EngineConfig(STEP_NS)) as engine:
        wall = engine.add(a_box("wall", 1.0, is_static=True), a_state())

        engine.set_base_state(wall, np.array([2.0, *[0.0] * 5, 1.0, *[1.0] * 6]))
        advance(engine, 2)

        assert engine.read((wall,)).base[0].tolist() == [2.0, *[0.0] * 5, 1.0, *[0.0] * 6]


SHELF = (((-0.5, -0.5, 0.0), (-0.4, 0.5, 1.0)), ((0.4, -0.5, 0.0), (0.5, 0.5, 1.0)))
SOFA = (((0.0, -0.4, 0.0), (0.8, 0.4, 0.4)), ((0.6, -0.4, 0.4), (0.8, 0.4, 0.8)))
"""Two cuboids each, as lowest and highest corners."""


def a_piece_of_furniture(name: str, *, is_static: bool = False) -> Model:
    inertial = Inertial(20.0, (0.4, 0.0, 0.3), (2.0, 0.0, 0.0, 2.0, 0.0, 2.0))
    shape = Shape("mesh", (1.0, 1.0, 1.0), mesh=name)
    return Model(name, (Link("base", inertial, (shape,)),), is_static=is_static)


@pytest.mark.parametrize("make", [PyBulletEngine, MujocoEngine])
def test_furniture_of_meshes_that_overlaps_parts_slowly(make: MakeEngine, tmp_path: Path) -> None:
    for name, cuboids in (("shelf", SHELF), ("sofa", SOFA)):
        corners = np.concatenate([a_cuboid(low, high) for low, high in cuboids])
        (tmp_path / f"{name}.stl").write_bytes(write_corners(corners.reshape(-1, 3, 3)))
    config = EngineConfig(1_000_000, gravity=(0.0, 0.0, -9.81), mesh_folder=str(tmp_path))
    with running(make, config) as engine:
        shelf = engine.add(a_piece_of_furniture("shelf", is_static=True), a_state())
        sofa, chair = (
            engine.add(a_piece_of_furniture("sofa"), a_state((x, 0.0, 0.0))) for x in (0.45, 1.2)
        )
        named = [list(engine.find_overlaps(body)) for body in (sofa, chair)]
        fastest = 0.0
        for _ in range(2000):
            advance(engine, 1)
            fastest = max(fastest, np.abs(engine.read((sofa, chair)).base[:, 7:10]).max())
        left = [list(engine.find_overlaps(body)) for body in (sofa, chair)]

    assert named == [[shelf, chair], [sofa]]
    # The sofa parts from the shelf, and the chair from the sofa.
    assert fastest < 2.5 * MAX_PENETRATION_RECOVERY_MPS
    assert left == [[], []]


def test_engine_tells_nothing_of_a_box_in_the_air(engine: Engine) -> None:
    box = engine.add(a_box(), a_state((0.0, 0.0, 2.0)))
    advance(engine, 3)

    assert len(engine.read_contacts((box,))) == 0


def test_engine_tells_both_sides_of_a_stack(engine: Engine) -> None:
    low = engine.add(a_box(), a_state((0.0, 0.0, 0.1)))
    high = engine.add(a_box(), a_state((0.0, 0.0, 0.3)))
    advance(engine, 480)

    below, above = (engine.read_contacts((body,)) for body in (low, high))

    on_high = above.points[:, 7:].sum(axis=0)
    assert (above.bodies[:, 2] == low).all()
    assert on_high == pytest.approx([0.0, 0.0, WEIGHT_N], rel=0.05, abs=0.1)
    from_high = below.points[below.bodies[:, 2] == high, 7:].sum(axis=0)
    from_ground = below.points[below.bodies[:, 2] == GROUND, 7:].sum(axis=0)
    assert from_high == pytest.approx(-on_high, abs=1e-6)
    assert from_ground[2] == pytest.approx(2.0 * WEIGHT_N, rel=0.05)


@pytest.mark.parametrize("make", [PyBulletEngine, MujocoEngine])
def test_engine_tells_the_friction_that_holds_boxes_on_a_slope(make: MakeEngine) -> None:
    slope = EngineConfig(STEP_NS, gravity=(2.0, 0.0, -9.81))
    with running(make, slope) as engine:
        boxes = [engine.add(a_box(), a_state((0.0, 0.0, z))) for z in (0.1, 0.3)]
        advance(engine, 240)

        low, high = (engine.read_contacts((box,)).points[:, 7:].sum(axis=0) for box in boxes)

        assert low == pytest.approx([-2.0, 0.0, WEIGHT_N], abs=0.1)
        assert high == pytest.approx([-2.0, 0.0, WEIGHT_N], abs=0.1)


def test_engine_tells_which_links_touch(engine: Engine) -> None:
    """A post that stands beside its arm, whose end rests on a static block."""
    joint = Joint("swing", "revolute", "post", "arm", Origin((0, 0, 0.5)), (0, 1, 0), -3.0, 3.0)
    hanging = Inertial(1.0, (0.4, 0.0, 0.0), (0.01, 0.0, 0.0, 0.01, 0.0, 0.01))
    arm = Link("arm", hanging, (Shape("box", (0.1, 0.1, 0.1), Origin((0.4, 0.0, 0.0))),))
    crane = Model("crane", (Link("post", a_body()), arm), (joint,), is_static=True)
    block = engine.add(a_box(side_m=0.4, is_static=True), a_state((0.4, 0.0, 0.2)))
    body = engine.add(crane, a_state())
    advance(engine, 480)

    found = engine.read_contacts((body,))

    assert {tuple(row) for row in found.bodies.tolist()} == {(body, 1, block, 0)}
    assert found.points[:, 9].sum() > 1.0


def test_engine_tells_a_touch_within_three_steps(engine: Engine) -> None:
    """Source: a fall of 0.05 m takes sqrt(2 h / g)."""
    box = engine.add(a_box(), a_state((0.0, 0.0, 0.15)))
    falls = round((2.0 * 0.05 / 9.81) ** 0.5 / STEP_NS * 1e9)

    readings = []
    for _ in range(falls + 10):
        engine.step()
        readings.append(bool(len(engine.read_contacts((box,)))))

    assert readings.index(True) == pytest.approx(falls, abs=3)


@pytest.mark.parametrize("make", [PyBulletEngine, MujocoEngine])
def test_kinematic_robot_feels_a_wall_without_a_force(make: MakeEngine) -> None:
    config = EngineConfig(STEP_NS)
    with running(lambda one: TieredEngine(make(one), one, "kinematic"), config) as engine:
        wall = engine.add(a_box(side_m=0.4, is_static=True), a_state((0.6, 0.0, 0.2)))
        robot = engine.add(a_box_bot(), box_bot_at())
        engine.command((robot,), np.array([10.0, 10.0]))
        advance(engine, 24)
        before = engine.read_contacts((robot,))
        advance(engine, 480)

        found = engine.read_contacts((robot,))

        assert engine.tier_of(robot) == "kinematic"
        assert len(before) == 0
        assert found.bodies.tolist() == [[robot, 0, wall, 0]]
        assert found.points[0, 0] == pytest.approx(0.4, abs=0.01)
        assert found.points[0, 3:6] == pytest.approx([-1.0, 0.0, 0.0], abs=1e-3)
        assert not found.points[0, 6:].any()
        engine.command((robot,), np.array([-10.0, -10.0]))
        advance(engine, 24)
        assert len(engine.read_contacts((robot,))) == 0

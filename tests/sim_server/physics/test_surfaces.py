"""Measured effect of each tag of <gazebo> blocks in each engine."""

import math
from collections.abc import Iterator

import numpy as np
import pytest

from tests.engines import PHYSICAL, STEP_NS, MakeEngine, advance, running
from tests.models import a_state
from tests.sim_server.description.robots import (
    a_collision,
    a_joint,
    a_link,
    a_reference,
    a_robot,
    an_inertial,
    subjects,
)
from zensim.proto.messages.model_messages import Model
from zensim.sim_server.description.link_surfaces import to_decay_rate
from zensim.sim_server.description.sdf.sdf_model import read_sdf_model
from zensim.sim_server.description.urdf.urdf_parser import read_urdf
from zensim.sim_server.physics.engine import Engine, FloatArray
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.mujoco.mujoco_engine import MujocoEngine

every_engine = pytest.mark.parametrize("make", PHYSICAL, ids=lambda make: make.name)
DT_S = STEP_NS * 1e-9
G = 9.81
BOX = '<geometry><box size="0.2 0.2 0.2"/></geometry>'
BALL = '<geometry><sphere radius="0.1"/></geometry>'


@pytest.fixture(params=PHYSICAL, ids=lambda make: make.name)
def engine(request: pytest.FixtureRequest) -> Iterator[Engine]:
    with running(request.param) as made:
        yield made


def a_cube(tags: str = "", *parts: str) -> Model:
    cube = a_link("cube", an_inertial("1", "0.00667") + a_collision(BOX))
    return read_urdf(a_robot(cube, *parts, a_reference("cube", tags)))


def find_penetration(engine: Engine, tags: str) -> float:
    # Exactly along the axes, PyBullet balances it on two opposite corners.
    body = engine.add(a_cube(tags), a_state((0.0, 0.0, 0.1), turn=(0.0, 0.0, 0.3)))
    advance(engine, 480)
    return 0.1 - float(engine.read([body]).base[0, 2])


def find_deceleration(engine: Engine, tags: str, heading: float, yaw: float = 0.0) -> float:
    """Slide a cube along a heading; return its deceleration [g]."""
    way = (math.cos(heading + yaw), math.sin(heading + yaw))
    start = a_state((0.0, 0.0, 0.1), turn=(0.0, 0.0, yaw), linear=(2.0 * way[0], 2.0 * way[1], 0.0))
    body = engine.add(a_cube(tags), start)
    advance(engine, 24)
    velocity = engine.read([body]).base[0, 7:9]
    engine.remove(body)
    return (2.0 - float(velocity @ way)) / (24 * DT_S) / G


@pytest.mark.parametrize("stiffness", [1e3, 1e4, 1e5])
@pytest.mark.parametrize("damping", ["", "<kd>1</kd>", "<kd>100</kd>"])
def test_cube_penetrates_by_its_stiffness(engine: Engine, stiffness: float, damping: str) -> None:
    found = find_penetration(engine, f"<kp>{stiffness}</kp>{damping}")

    assert found == pytest.approx(G / (4.0 * stiffness), rel=0.05, abs=2e-5)


@pytest.mark.parametrize("tags", ["", "<kp>1e12</kp><kd>1</kd>", "<kp>1e27</kp><kd>1e27</kd>"])
def test_rigid_cube_does_not_penetrate(engine: Engine, tags: str) -> None:
    assert abs(find_penetration(engine, tags)) < 5e-5


@pytest.mark.parametrize("stiffness", ["1e4", "1e6", "1e8", "1e12"])
def test_cube_spawned_in_the_ground_does_not_jump(engine: Engine, stiffness: str) -> None:
    body = engine.add(a_cube(f"<kp>{stiffness}</kp><kd>1</kd>"), a_state((0.0, 0.0, 0.08)))

    heights = []
    for _ in range(240):
        engine.step()
        heights.append(float(engine.read([body]).base[0, 2]))

    assert max(heights) < 0.15


@pytest.mark.parametrize("yaw", [0.0, 0.4])
@pytest.mark.parametrize(
    ("direction", "along"), [("1 0 0", 0.0), ("0 1 0", math.pi / 2.0), ("-1 1 0", 0.75 * math.pi)]
)
def test_cube_slides_by_mu1_along_fdir1_and_by_mu2_across(
    engine: Engine, direction: str, along: float, yaw: float
) -> None:
    tags = f"<mu1>0.4</mu1><mu2>0.1</mu2><fdir1>{direction}</fdir1>"
    # Measured against cubes of one friction.
    for heading, friction in ((along, 0.4), (along + math.pi / 2.0, 0.1)):
        plain = find_deceleration(engine, f"<mu1>{friction}</mu1>", heading, yaw)
        assert find_deceleration(engine, tags, heading, yaw) == pytest.approx(plain, rel=0.2)


def a_rover(*tags: str, angle: str = "1.5707963", mass: str = "10") -> Model:
    """A base on four free wheels, whose cylinders the file turns onto their axles."""
    shape = '<geometry><cylinder radius="0.1" length="0.05"/></geometry>'
    upright = f'<origin rpy="{angle} 0 0"/>'
    parts = [a_link("base", an_inertial(mass, "0.3", '<origin xyz="0.03 0.02 0"/>'))]
    for number, (x, y) in enumerate(((0.2, 0.15), (0.2, -0.15), (-0.2, -0.15), (-0.2, 0.15))):
        wheel = f"wheel{number}"
        place = f'<origin xyz="{x} {y} 0"/><axis xyz="0 1 0"/>'
        parts += [
            a_link(wheel, an_inertial("0.5", "0.002") + a_collision(shape, upright)),
            a_joint(f"axle{number}", ("base", wheel), "continuous", place),
            *(a_reference(wheel, one) for one in tags[number : number + 1]),
        ]
    return read_urdf(a_robot(*parts))


def a_mecanum(tags: str) -> Model:
    """A rover whose friction has the directions of the rollers of a mecanum."""
    sides = (-1, 1, -1, 1)
    return a_rover(*(f"{tags}<fdir1>1 {side} 0</fdir1>" for side in sides))


@pytest.mark.parametrize("angle", ["1.57", "1.5708", "1.5707963267948966"])
@pytest.mark.parametrize("speed", [0.0, 0.02, 0.2])
def test_rover_that_nobody_drives_keeps_its_speed(engine: Engine, angle: str, speed: float) -> None:
    body = engine.add(a_rover(angle=angle), a_state((0.0, 0.0, 0.1), linear=(speed, 0.0, 0.0)))
    advance(engine, 240)
    begun = float(engine.read([body]).base[0, 7])

    advance(engine, 960)

    assert float(engine.read([body]).base[0, 7]) == pytest.approx(begun, abs=5e-4)


def test_wheels_without_friction_across_stand_still_in_mujoco() -> None:
    with running(MujocoEngine) as engine:
        body = engine.add(a_mecanum("<mu1>3</mu1><mu2>0</mu2>"), a_state((0.0, 0.0, 0.1)))

        advance(engine, 480)

        assert engine.read([body]).base[0, :3] == pytest.approx([0.0, 0.0, 0.1], abs=1e-5)


def test_cube_slides_by_the_mean_when_no_direction_is_given(engine: Engine) -> None:
    for heading in (0.0, 1.0):
        plain = find_deceleration(engine, "<mu1>0.3</mu1>", heading)
        assert find_deceleration(engine, "<mu1>0.4</mu1><mu2>0.2</mu2>", heading) == pytest.approx(
            plain
        )


@pytest.mark.parametrize(
    "tag", ["<gravity>false</gravity>", "<turnGravityOff>true</turnGravityOff>"]
)
def test_link_without_gravity_stays_in_the_air(engine: Engine, tag: str) -> None:
    body = engine.add(a_cube(tag), a_state((0.0, 0.0, 3.0), angular=(0.3, 0.2, 0.1)))

    advance(engine, 240)

    row = engine.read([body]).base[0]
    assert row[:3] == pytest.approx([0.0, 0.0, 3.0], abs=1e-4)
    assert row[10:] == pytest.approx([0.3, 0.2, 0.1], abs=1e-4)


@pytest.mark.parametrize("tag", ["<gravity>true</gravity>", "<turnGravityOff>0</turnGravityOff>"])
def test_link_falls_when_its_gravity_is_on(engine: Engine, tag: str) -> None:
    body = engine.add(a_cube(tag), a_state((0.0, 0.0, 30.0)))

    advance(engine, 240)

    assert float(engine.read([body]).base[0, 2]) == pytest.approx(30.0 - G / 2.0, rel=0.01)


def a_pendulum(tags: str, kind: str = "continuous") -> Model:
    """An arm of 1 kg, 0.4 m from its joint with the world."""
    arm = an_inertial("1", "0.01", '<origin xyz="0.4 0 0"/>')
    place = '<origin xyz="0 0 2"/><axis xyz="0 1 0"/>'
    return read_urdf(
        a_robot(
            a_link("world"),
            a_link("arm", arm),
            a_joint("pin", ("world", "arm"), kind, place),
            a_reference("arm", tags),
        )
    )


def test_arm_without_gravity_stays_level(engine: Engine) -> None:
    free, pulled = (
        engine.add(a_pendulum(tags), a_state()) for tags in ("<gravity>0</gravity>", "")
    )

    advance(engine, 60)

    level, hanging = engine.read([free, pulled]).joint_positions.tolist()
    assert level == pytest.approx(0.0, abs=1e-4)
    assert hanging > 0.2


def test_merged_link_without_gravity_compensates_its_own_weight_only(engine: Engine) -> None:
    """3 kg with and 1 kg without gravity: three quarters of g, and the light end rises."""
    parts = (
        a_link("tail", an_inertial("3", "0.02")),
        a_joint("j", ("cube", "tail"), inside='<origin xyz="-0.5 0 0"/>'),
    )
    body = engine.add(a_cube("<gravity>false</gravity>", *parts), a_state((0.0, 0.0, 50.0)))

    advance(engine, 24)

    row = engine.read([body]).base[0]
    com = row[7:10] + np.cross(row[10:13], [-0.375, 0.0, 0.0])
    assert float(com[2]) == pytest.approx(-0.75 * G * 24 * DT_S, rel=0.02)
    assert row[11] < -0.1


@pytest.mark.parametrize("share", [0.001, 0.01, 0.5])
@every_engine
def test_link_is_damped_by_its_damping_factor(make: MakeEngine, share: float) -> None:
    engine = make(EngineConfig(STEP_NS, gravity=(0.0, 0.0, 0.0), has_ground=False))
    start = a_state(linear=(2.0, 0.0, 0.0), angular=(0.0, 0.0, 3.0))
    body = engine.add(a_cube(f"<dampingFactor>{share}</dampingFactor>"), start)

    advance(engine, 24)

    row = engine.read([body]).base[0]
    engine.close()
    left = (1.0 - share) ** (24 * DT_S / 1e-3)
    assert left == pytest.approx(math.exp(-to_decay_rate(share) * 24 * DT_S))
    assert row[7] == pytest.approx(2.0 * left, rel=0.01, abs=1e-6)
    assert row[12] == pytest.approx(3.0 * left, rel=0.01, abs=1e-6)


def test_arm_is_damped_by_its_damping_factor(engine: Engine) -> None:
    damped, free = (
        engine.add(a_pendulum(tags), a_state())
        for tags in ("<dampingFactor>0.02</dampingFactor>", "")
    )

    advance(engine, 60)

    slow, fast = engine.read([damped, free]).joint_velocities.tolist()
    assert 0.0 < slow < 0.5 * fast


def two_fingers(tags: str = "", model_tags: str = "") -> Model:
    """Two balls on arms that fall towards each other."""
    palm = a_link("world") + a_link("palm", an_inertial())
    nail = a_joint("nail", ("world", "palm"))
    fingers = ""
    for name, y, turn in (("left", 0.15, "1 0 0"), ("right", -0.15, "-1 0 0")):
        ball = '<origin xyz="0 0 0.5"/>'
        inside = an_inertial("1", "0.01", ball) + a_collision(BALL, ball)
        place = f'<origin xyz="0 {y} 2"/><axis xyz="{turn}"/>'
        limit = '<limit lower="-1" upper="1" effort="1" velocity="9"/>'
        fingers += a_link(name, inside)
        fingers += a_joint(f"{name}_joint", ("palm", name), "revolute", place + limit)
    return read_urdf(
        a_robot(*(palm, nail, fingers, a_reference("left", tags)), f"<gazebo>{model_tags}</gazebo>")
    )


def find_gap(engine: Engine, model: Model) -> float:
    """Push the balls together by gravity along y; return the final distance of their centres."""
    body = engine.add(model, a_state())
    engine.set_at_rest(body, a_state(), np.array([0.1, 0.1]))
    advance(engine, 240)
    left, right = engine.read([body]).joint_positions.tolist()
    return 0.3 - 0.5 * (math.sin(left) + math.sin(right))


@pytest.mark.parametrize(
    ("tags", "model_tags", "do_touch"),
    [
        ("", "", False),
        ("<selfCollide>true</selfCollide>", "", True),
        ("<selfCollide>false</selfCollide>", "", False),
        ("", "<self_collide>true</self_collide>", True),
    ],
)
def test_links_collide_with_self_collision_enabled(
    engine: Engine, tags: str, model_tags: str, *, do_touch: bool
) -> None:
    gap = find_gap(engine, two_fingers(tags, model_tags))

    assert (gap > 0.19) == do_touch


def test_links_of_one_joint_do_not_collide(engine: Engine) -> None:
    """The ball encloses its joint, inside the cube: a contact would throw it out."""
    arm = a_link("arm", an_inertial("0.1", "0.001") + a_collision(BALL))
    pin = a_joint("pin", ("cube", "arm"), "continuous", '<axis xyz="0 0 1"/>')
    body = engine.add(a_cube("<selfCollide>true</selfCollide>", arm, pin), a_state((0.0, 0.0, 0.1)))

    advance(engine, 240)

    reading = engine.read([body])
    assert reading.base[0, :3] == pytest.approx([0.0, 0.0, 0.1], abs=1e-3)
    assert abs(float(reading.joint_velocities[0])) < 1e-3


def test_static_robot_does_not_move(engine: Engine) -> None:
    arm = a_link("arm", an_inertial("1", "0.01", '<origin xyz="0.4 0 0"/>'))
    pin = a_joint("pin", ("cube", "arm"), "continuous", '<axis xyz="0 1 0"/>')
    model = a_cube("", arm, pin, "<gazebo><static>true</static></gazebo>")
    start = a_state((0.0, 0.0, 3.0))
    body = engine.add(model, start)

    advance(engine, 120)

    assert model.joints == ()
    assert [frame.name for frame in model.frames] == ["arm"]
    assert "gazebo: <static>" in subjects(model.report, "applied")
    assert np.array_equal(moved(engine, body, start), np.zeros(13))


def moved(engine: Engine, body: int, start: FloatArray) -> FloatArray:
    return np.round(np.asarray(engine.read([body]).base[0]) - start, 9) + 0.0


@pytest.mark.parametrize("ground", [1.0, 100.0])
@every_engine
def test_cube_keeps_its_friction_on_rougher_ground(make: MakeEngine, ground: float) -> None:
    engine = make(EngineConfig(STEP_NS, ground_friction=ground))

    found = find_deceleration(engine, "<mu1>0.3</mu1>", 0.0)

    engine.close()
    assert found == pytest.approx(0.3, rel=0.05)


def an_sdf_cube(link: str = "", surface: str = "", model: str = "") -> Model:
    return read_sdf_model(
        f'<sdf version="1.7"><model name="m">{model}<link name="cube">{link}'
        "<inertial><mass>1</mass><inertia><ixx>0.00667</ixx><iyy>0.00667</iyy><izz>0.00667</izz></inertia></inertial>"
        '<collision name="c"><geometry><box><size>0.2 0.2 0.2</size></box></geometry>'
        f"<surface>{surface}</surface></collision></link></model></sdf>"
    )


def test_sdf_link_surface_gravity_and_damping_take_effect(engine: Engine) -> None:
    soft = "<contact><ode><kp>1000</kp><kd>1</kd></ode></contact>"
    decay = "<velocity_decay><linear>0.01</linear><angular>0.02</angular></velocity_decay>"
    turned = a_state((0.0, 0.0, 0.1), turn=(0.0, 0.0, 0.3))
    sinking = engine.add(an_sdf_cube(surface=soft), turned)
    start = a_state((0.0, 5.0, 3.0), linear=(2.0, 0.0, 0.0), angular=(0.0, 0.0, 3.0))
    floating = engine.add(an_sdf_cube(f"<gravity>false</gravity>{decay}"), start)

    advance(engine, 24)
    row = engine.read([floating]).base[0]
    advance(engine, 456)

    elapsed_s = 24 * DT_S
    assert row[2] == pytest.approx(3.0, abs=1e-4)
    assert row[7] == pytest.approx(2.0 * 0.99 ** (elapsed_s / 1e-3), rel=0.01)
    assert row[12] == pytest.approx(3.0 * 0.98 ** (elapsed_s / 1e-3), rel=0.02)
    assert 0.1 - engine.read([sinking]).base[0, 2] == pytest.approx(G / 4000.0, rel=0.05)


def test_sdf_self_collide_is_read_for_models_and_links() -> None:
    flag = "<self_collide>true</self_collide>"

    assert not an_sdf_cube().links[0].self_collides
    assert an_sdf_cube(flag).links[0].self_collides
    assert an_sdf_cube(model=flag).links[0].self_collides
    assert subjects(an_sdf_cube(flag, model=flag).report, "ignored") == []

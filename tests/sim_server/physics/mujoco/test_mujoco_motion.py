"""MujocoEngine: robots with sliding supports drive as commanded, and joints have springs."""

import math

import msgspec
import numpy as np
import pytest

from tests.engines import STEP_NS, advance
from tests.models import WHEEL_RADIUS_M, a_body, a_box, a_cart, a_state, an_arm, on_ground
from zensim.proto.messages.model_messages import Contact, Inertial, Joint, Link, Model, Origin
from zensim.proto.se3 import to_yaw
from zensim.sim_server.physics.blueprint import make_blueprint
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.mujoco.mjcf import find_joint_inertia
from zensim.sim_server.physics.mujoco.mujoco_engine import MujocoEngine
from zensim.sim_server.physics.mujoco.slot_layout import make_archetype

CONFIG = EngineConfig(STEP_NS)
DT_S = STEP_NS * 1e-9
SECOND = 240
HARD = Contact(stiffness=1e9, damping=1e9)
replace = msgspec.structs.replace


def a_dragging_cart(
    *,
    caster: float = 0.5,
    wheel: float = 1.0,
    wheel_kg: float = 0.2,
    contact: Contact | None = None,
) -> Model:
    """A cart whose casters have friction and touch the ground, with wheels of a given friction."""
    cart = a_cart()
    base, *wheels = cart.links
    deck, *casters = base.collisions
    contact = contact or Contact()
    lowered = [
        replace(
            one,
            friction=caster,
            contact=contact,
            origin=replace(one.origin, position=(one.origin.position[0], 0.0, -0.03)),
        )
        for one in casters
    ]
    inertial = a_body(wheel_kg, wheel_kg * WHEEL_RADIUS_M**2 / 2.0)
    rolling = [
        replace(
            link,
            inertial=inertial,
            collisions=(replace(link.collisions[0], friction=wheel, contact=contact),),
        )
        for link in wheels
    ]
    return replace(cart, links=(replace(base, collisions=(deck, *lowered)), *rolling))


def drive(model: Model, linear: float, angular: float) -> tuple[float, float]:
    """Drive for 2 s; return speed ahead [m/s] and turn [rad/s], mean of the last second."""
    engine = MujocoEngine(CONFIG)
    body = engine.add(model, on_ground())
    advance(engine, SECOND)
    assert model.drive is not None
    turn = angular * 0.15
    speeds = {"right_joint": linear + turn, "left_joint": linear - turn}
    targets = [speeds[actuator.joint] / WHEEL_RADIUS_M for actuator in model.actuators]
    engine.command([body], np.array(targets))
    advance(engine, SECOND)
    before = engine.read([body]).base[0]
    advance(engine, SECOND)
    after = engine.read([body]).base[0]
    engine.close()
    turned = float(to_yaw(after[3:7]) - to_yaw(before[3:7]))
    return float(np.hypot(*(after - before)[:2])), turned


@pytest.mark.parametrize(
    "model",
    [
        a_dragging_cart(),
        a_dragging_cart(caster=0.7),
        a_dragging_cart(wheel_kg=0.002),
        a_dragging_cart(wheel=10.0, contact=HARD),
        a_dragging_cart(wheel=1e5),
    ],
    ids=["friction", "high friction", "light wheels", "hard contacts", "unlimited grip"],
)
def test_robot_with_dragged_casters_drives_as_commanded(model: Model) -> None:
    ahead, drift = drive(model, 0.2, 0.0)
    _, turn = drive(model, 0.0, 0.5)

    assert ahead == pytest.approx(0.2, rel=0.01)
    assert abs(drift) < 0.01
    assert turn == pytest.approx(0.5, rel=0.02)


def a_skate(along: float, across: float) -> Model:
    """A box with these frictions along its y axis and across it."""
    box = a_box("slider")
    contact = Contact(direction=(0.0, 1.0, 0.0), friction_across=across)
    (shape,) = box.links[0].collisions
    rubbing = replace(shape, friction=along, contact=contact)
    return replace(box, links=(replace(box.links[0], collisions=(rubbing,)),))


@pytest.mark.parametrize(
    ("along", "across", "ground", "deceleration"),
    [(0.4, 0.1, 1.0, 0.4), (0.0, 0.3, 1.0, 0.0), (0.4, 0.1, 0.2, 0.2)],
    ids=["rough along", "smooth along", "smoother ground"],
)
def test_box_slides_along_its_direction_by_the_lesser_friction(
    along: float, across: float, ground: float, deceleration: float
) -> None:
    engine = MujocoEngine(EngineConfig(STEP_NS, ground_friction=ground))
    start = a_state((0.0, 0.0, 0.1), linear=(0.0, 3.0, 0.0))
    body = engine.add(a_skate(along, across), start)
    steps = 4

    advance(engine, steps)

    velocity = engine.read([body]).base[0, 7:9]
    engine.close()
    assert velocity[1] == pytest.approx(3.0 - deceleration * 9.81 * steps * DT_S, rel=0.01)
    assert velocity[0] == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("slider", [a_box("slider"), a_skate(0.4, 0.1)], ids=["box", "skate"])
def test_robots_drive_equally_when_another_one_slides(slider: Model) -> None:
    def run(*, with_slider: bool) -> bytes:
        engine = MujocoEngine(CONFIG)
        robot = engine.add(a_dragging_cart(), on_ground())
        other = engine.add(slider, a_state((5.0, 0.0, 0.1), linear=(2.0, 0.0, 0.0)))
        if not with_slider:
            engine.remove(other)
        engine.command([robot], np.array([4.0, 6.0]))
        advance(engine, SECOND)
        reading = engine.read([robot])
        engine.close()
        return reading.base.tobytes() + reading.joint_velocities.tobytes()

    assert run(with_slider=True) == run(with_slider=False)


def armature_of(model: Model) -> float:
    """Find the armature of the first joint."""
    return find_joint_inertia(make_archetype(make_blueprint(model)), 1, model.joints[0].axis)[0]


def test_armature_completes_the_least_moment_of_a_driven_wheel() -> None:
    light, heavy = a_dragging_cart(wheel_kg=0.002), a_dragging_cart(wheel_kg=50.0)
    own = 0.002 * WHEEL_RADIUS_M**2 / 2.0

    assert armature_of(light) == pytest.approx(0.2 * light.mass_kg * WHEEL_RADIUS_M**2 - own)
    assert armature_of(heavy) == 0.0
    assert armature_of(an_arm("continuous")) == 0.0


def a_cart_on_a_ball_caster(caster_kg: float = 0.005) -> Model:
    """A cart whose back caster turns about three axes; the links between them have no weight."""
    cart = a_cart()
    base, *wheels = cart.links
    deck, _, back = base.collisions
    ball = replace(back, size=(0.005, 0.0, 0.0), origin=Origin(), friction=1.0)
    heavier = replace(base.inertial, com_in_link=(-0.02, 0.0, 0.0))
    ends = [
        Link("pitch", Inertial()),
        Link("yaw", Inertial()),
        Link("roll", a_body(caster_kg, 1e-5)),
    ]
    ends[-1] = replace(ends[-1], collisions=(ball,))
    names = ("base", "pitch", "yaw", "roll")
    axes = ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0))
    places = (replace(back.origin, position=(-0.1, 0.0, -0.045)), Origin(), Origin())
    casters = tuple(
        Joint(f"{child}_joint", "continuous", parent, child, origin=place, axis=axis)
        for parent, child, place, axis in zip(names[:-1], names[1:], places, axes, strict=True)
    )
    root = replace(base, inertial=heavier, collisions=(deck,))
    return replace(cart, links=(root, *wheels, *ends), joints=(*cart.joints, *casters))


@pytest.mark.parametrize(("linear", "angular"), [(0.2, 0.0), (0.0, 0.5), (0.1, 0.3)])
def test_ball_caster_of_three_joints_rolls(linear: float, angular: float) -> None:
    engine = MujocoEngine(CONFIG)
    body = engine.add(a_cart_on_a_ball_caster(), on_ground())
    speeds = np.array([linear - 0.15 * angular, linear + 0.15 * angular]) / WHEEL_RADIUS_M
    engine.command([body], speeds)
    advance(engine, 6 * SECOND)

    base = engine.read([body]).base[0]
    engine.close()
    assert np.hypot(*base[7:9]) == pytest.approx(linear, rel=0.02, abs=0.003)
    assert base[12] == pytest.approx(angular, rel=0.02, abs=0.01)


@pytest.mark.parametrize("seed", range(3))
def test_ball_caster_rolls_on_from_every_angle(seed: int) -> None:
    engine, random = MujocoEngine(CONFIG), np.random.default_rng(seed)
    body = engine.add(a_cart_on_a_ball_caster(0.001), on_ground())
    for linear, angular in [(0.2, 0.0), (0.0, 0.5), (0.0, -0.5)] * 4:
        speeds = np.array([linear - 0.15 * angular, linear + 0.15 * angular]) / WHEEL_RADIUS_M
        engine.command([body], speeds)
        advance(engine, round(random.uniform(0.25, 2.0) * SECOND))

        base = engine.read([body]).base[0]
        assert np.hypot(*base[7:9]) == pytest.approx(linear, abs=0.003)
        assert base[12] == pytest.approx(angular, abs=0.01)
    engine.close()


@pytest.mark.parametrize(("com_m", "share"), [(0.0, 0.3), (0.1, 0.03)])
def test_armature_of_weightless_links_is_greater_for_casters_than_for_pendulums(
    com_m: float, share: float
) -> None:
    model = a_cart_on_a_ball_caster()
    bob = replace(model.links[-1].inertial, com_in_link=(0.0, 0.0, -com_m))
    model = replace(model, links=(*model.links[:-1], replace(model.links[-1], inertial=bob)))
    archetype = make_archetype(make_blueprint(model))

    armature, _ = find_joint_inertia(archetype, 4, (0.0, 0.0, 1.0))

    moment = max(archetype.link_parts[-1].inertia)
    assert armature == pytest.approx(share * moment, rel=0.1)


def a_sprung_mass(stiffness: float, *, damping: float = 0.0, reference: float = 0.0) -> Model:
    """A mass of 2 kg on a vertical spring."""
    arm = an_arm("prismatic", damping=damping)
    joint = replace(arm.joints[0], spring_stiffness=stiffness, spring_reference=reference)
    mass = Link("arm", Inertial(2.0, inertia=(0.01, 0.0, 0.0, 0.01, 0.0, 0.01)))
    return replace(arm, links=(arm.links[0], mass), joints=(joint,))


def record_positions(model: Model, steps: int) -> list[float]:
    engine = MujocoEngine(CONFIG)
    body = engine.add(model, a_state())
    found = []
    for _ in range(steps):
        engine.step()
        found.append(float(engine.read([body]).joint_positions[0]))
    engine.close()
    return found


def test_mass_oscillates_on_a_spring_as_the_closed_form_says() -> None:
    stiffness, reference = 200.0, 0.05
    sag = reference - 2.0 * 9.81 / stiffness
    frequency = math.sqrt(stiffness / 2.0)

    found = record_positions(a_sprung_mass(stiffness, reference=reference), 2 * SECOND)

    expected = [
        sag * (1.0 - math.cos(frequency * DT_S * step)) for step in range(1, 2 * SECOND + 1)
    ]
    assert found == pytest.approx(expected, abs=0.06 * abs(sag))


@pytest.mark.parametrize("stiffness", [400.0, 1e5, 1e9])
def test_mass_comes_to_rest_on_a_damped_spring_of_any_stiffness(stiffness: float) -> None:
    found = record_positions(a_sprung_mass(stiffness, damping=50.0, reference=0.03), 4 * SECOND)

    assert found[-1] == pytest.approx(0.03 - 2.0 * 9.81 / stiffness, abs=1e-5)


def test_hidden_and_removed_bodies_are_not_moved_by_their_springs() -> None:
    engine = MujocoEngine(CONFIG)
    body, other = (
        engine.add(a_sprung_mass(200.0, reference=0.1), a_state((x, 0.0, 0.0))) for x in (0.0, 3.0)
    )
    engine.hide(body)
    engine.remove(other)
    advance(engine, 24)

    assert engine.read([body]).joint_positions.tolist() == [0.0]
    engine.show([body])
    advance(engine, 24)
    assert engine.read([body]).joint_positions[0] != 0.0
    engine.close()


def a_rod_with_a_tip() -> Model:
    """A rod on a ball joint of three hinges without weight, and a light link that turns at its end.

    Cassie has such rods: with MuJoCo's faster integrator their spins grew until they diverged.
    """
    feather = Inertial(1e-4, inertia=(1e-9, 0.0, 0.0, 1e-9, 0.0, 1e-9))
    rod = Inertial(0.16, (0.25, 0.0, 0.0), (7.6e-5, 0.0, 0.0, 3.3e-3, 0.0, 3.3e-3))
    tip = Inertial(0.05, (0.03, 0.01, 0.0), (1e-5, 0.0, 0.0, 3e-5, 0.0, 3e-5))
    names, bodies = ("base", "a", "b", "rod", "tip"), (a_body(), feather, feather, rod, tip)
    axes = ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.6, 0.8))
    joints = [
        Joint(f"j{n}", "continuous", names[n], names[n + 1], Origin((0.5 * (n == 3), 0, 0)), axis)
        for n, axis in enumerate(axes)
    ]
    return Model("rod", tuple(map(Link, names, bodies)), tuple(joints), is_static=True)


@pytest.mark.parametrize("spin", [20.0, 40.0, 80.0])
def test_light_rods_on_ball_joints_spin_no_faster_by_themselves(spin: float) -> None:
    engine = MujocoEngine(EngineConfig(10_000_000))
    body = engine.add(a_rod_with_a_tip(), a_state())
    start = np.array((0.0, 0.3, 0.0, 0.4)), np.array((3.0, 2.0, spin, -spin))
    engine.set_state(body, a_state(), *start)

    most = 0.0
    for _ in range(2 * 100):
        engine.step()
        most = max(most, float(np.abs(engine.read((body,)).joint_velocities).max()))
    engine.close()

    assert most < 1.5 * spin + 10.0

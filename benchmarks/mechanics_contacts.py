"""Falls, friction, bounces and stacks, against the textbook."""

import math
from collections.abc import Iterator

from benchmarks.figures import Figure
from benchmarks.mechanics_scene import (
    BLOCK_SIZE,
    MILLIMETRES,
    G,
    Scene,
    Vector,
    deviation,
    moments_of_box,
    open_scene,
    write_ball,
    write_bounce,
    write_box,
    write_inertial,
)
from zensim import Robot

HALF_M = BLOCK_SIZE[0] / 2.0
FLAT: Vector = (0.6, 0.6, 0.1)
STATIC_PAIRS = ((0.4, 0.4), (0.3, 0.6), (0.6, 0.3), (1.0, 0.5), (0.5, 1.0), (0.5, 100.0))
"""Frictions of a block and of what is below it."""
MOVING_PAIRS = ((0.4, 0.4), (1.0, 0.5), (0.5, 1.0), (5.0, 0.5))
UNEQUAL_PAIR = (0.3, 0.6)
"""Both below 1 and moving: the figure of PyBullet is that which the report names."""
SLIDING_MPS = 2.0
RESTITUTIONS = (0.2, 0.5, 0.8)
DROP_M = 1.0
STACKED = 5
SUPPORTS_M = (-0.8, 0.4)
"""Supports of a bar of 2 m, from its centre."""
BAR_KG = 10.0
SPRING_N_PER_M = 5e4


def rows(engine: str, *, is_short: bool) -> Iterator[Figure]:
    """Measure each situation in one engine."""
    yield _measure_fall(engine)
    yield from _measure_friction(engine)
    yield from _measure_directions(engine)
    yield from _measure_bounces(engine)
    yield _measure_stack(engine, 5.0 if is_short else 60.0)
    yield _measure_supports(engine)


def _measure_fall(engine: str) -> Figure:
    """Measure a fall of 1 s; the step adds g t dt / 2, as it moves by the velocity at its end."""
    with open_scene(engine) as scene:
        body = scene.spawn(write_box(), (0.0, 0.0, 20.0))
        scene.world.run_for(1.0)
        time, step = scene.world.time, scene.world.step_period
        fallen = 20.0 - body.pose.z
    answer = G * time * (time + step) / 2.0
    return deviation(engine, "fall of 1 s", "mm", [(fallen - answer) * MILLIMETRES], 0.1)


def _measure_friction(engine: str) -> Iterator[Figure]:
    slides = [_slide_down(engine, *pair) - min(pair) for pair in STATIC_PAIRS]
    yield deviation(engine, "friction on a ramp, off the lesser", "", slides, 0.01)
    held = [_rest_on_ramp(engine, *pair) * MILLIMETRES for pair in STATIC_PAIRS]
    yield deviation(engine, "creep on a ramp 0.01 below the lesser, 5 s", "mm", held, 10.0)
    ways = [_slide_level(engine, mu) for mu in (0.2, 0.5, 1.0)]
    yield deviation(engine, "sliding distance, off v^2 / (2 mu g)", "%", ways, 2.0)
    moving = [_slide_on_sled(engine, *pair) - min(pair) for pair in MOVING_PAIRS]
    yield deviation(engine, "friction on a moving sled, off the lesser", "", moving, 0.01)
    mean = math.sqrt(math.prod(UNEQUAL_PAIR))
    answer = mean if engine == "pybullet" else min(UNEQUAL_PAIR)
    found = _slide_on_sled(engine, *UNEQUAL_PAIR) - answer
    what = "mean of roots, as predicted" if engine == "pybullet" else "lesser"
    yield deviation(engine, f"0.3 on a moving 0.6, off the {what}", "", [found], 0.01)


def _make_ramp(scene: Scene, block: float, ramp: float, slope: float) -> Robot:
    """Spawn a block at rest on a ramp down x; the slope is the tangent of its angle."""
    tilt = math.atan(slope)
    rpy = (0.0, tilt, 0.0)
    scene.spawn(
        write_box((8.0, 2.0, 0.2), tags=f"<mu1>{ramp}</mu1>", is_static=True),
        (0.0, 0.0, 3.0),
        rpy=rpy,
    )
    distance = HALF_M + 0.1
    place = (distance * math.sin(tilt), 0.0, 3.0 + distance * math.cos(tilt))
    return scene.spawn(write_box(tags=f"<mu1>{block}</mu1>"), place, rpy=rpy)


def _slide_down(engine: str, block: float, ramp: float) -> float:
    """Find the friction by the acceleration down a ramp that is too steep by 0.1."""
    slope = min(block, ramp) + 0.1
    with open_scene(engine) as scene:
        body = _make_ramp(scene, block, ramp, slope)
        acceleration = _find_acceleration(scene, body, 0.1, 0.5)
    return slope - acceleration * math.hypot(1.0, slope) / G


def _find_acceleration(scene: Scene, body: Robot, wait_s: float, count_s: float) -> float:
    scene.world.run_for(wait_s)
    speed, start = body.twist.vx, scene.world.time
    scene.world.run_for(count_s)
    return (body.twist.vx - speed) / (scene.world.time - start)


def _rest_on_ramp(engine: str, block: float, ramp: float) -> float:
    """Find how far [m] a block creeps on a ramp that is less steep than friction holds."""
    with open_scene(engine) as scene:
        body = _make_ramp(scene, block, ramp, min(block, ramp) - 0.01)
        scene.world.run_for(0.5)
        start = body.pose
        scene.world.run_for(5.0)
        return math.dist(start[:3], body.pose[:3])


def _slide_level(engine: str, friction: float) -> float:
    """Find by how much [%] the distance to a stop is off."""
    text = write_box(FLAT, tags=f"<mu1>{friction}</mu1>")
    found = _find_sliding_friction(engine, text, (1.0, 0.0, 0.0))
    return (friction / found - 1.0) * 100.0


def _find_sliding_friction(engine: str, text: str, direction: Vector) -> float:
    """Find the friction of a flat block by its distance to a stop; a step brakes at its start."""
    with open_scene(engine) as scene:
        body = scene.spawn(text, (0.0, 0.0, FLAT[2] / 2.0))
        scene.world.run_for(0.2)
        x, y, z = (SLIDING_MPS * part for part in direction)
        scene.push(body, (x, y, z))
        start = body.pose
        scene.world.run_for(3.0)
        way = math.dist(start[:2], body.pose[:2]) + SLIDING_MPS * scene.world.step_period / 2.0
    return SLIDING_MPS**2 / (2.0 * G * way)


def _slide_on_sled(engine: str, block: float, sled: float) -> float:
    """Find the friction of a block on a heavy body that can move."""
    with open_scene(engine) as scene:
        scene.spawn(
            write_box((4.0, 2.0, 0.2), mass_kg=500.0, tags=f"<mu1>{sled}</mu1>"), (0.0, 0.0, 0.1)
        )
        body = scene.spawn(write_box(tags=f"<mu1>{block}</mu1>"), (-1.0, 0.0, 0.2 + HALF_M))
        scene.world.run_for(0.2)
        scene.push(body, (SLIDING_MPS, 0.0, 0.0))
        return -_find_acceleration(scene, body, 0.05, 0.15) / G


def _measure_directions(engine: str) -> Iterator[Figure]:
    """Slide blocks with two frictions along and across the direction, from URDF and SDF."""
    urdf = write_box(FLAT, tags="<mu1>0.5</mu1><mu2>0.2</mu2><fdir1>1 0 0</fdir1>")
    sdf = (
        '<sdf version="1.9"><model name="m"><link name="l"><inertial><mass>1</mass><inertia>'
        "<ixx>0.031</ixx><iyy>0.031</iyy><izz>0.06</izz></inertia></inertial>"
        '<collision name="c"><geometry><box><size>0.6 0.6 0.1</size></box></geometry><surface>'
        "<friction><ode><mu>0.5</mu><mu2>0.2</mu2><fdir1>1 0 0</fdir1></ode></friction>"
        "</surface></collision></link></model></sdf>"
    )
    for kind, text in (("URDF", urdf), ("SDF", sdf)):
        found = [
            _find_sliding_friction(engine, text, direction) - friction
            for direction, friction in (((1.0, 0.0, 0.0), 0.5), ((0.0, 1.0, 0.0), 0.2))
        ]
        yield deviation(engine, f"mu1 along and mu2 across fdir1, {kind}", "", found, 0.01)


def _measure_bounces(engine: str) -> Iterator[Figure]:
    for kind in ("URDF", "SDF"):
        found = [(_find_rebound(engine, kind, e) / e - 1.0) * 100.0 for e in RESTITUTIONS]
        yield deviation(engine, f"speed of a rebound, off e of the impact, {kind}", "%", found, 3.0)
    if engine == "mujoco":  # in PyBullet it tumbles
        flat = [(_find_rebound(engine, "flat", e) / e - 1.0) * 100.0 for e in RESTITUTIONS]
        yield deviation(engine, "speed of a rebound of a flat box, off e", "%", flat, 3.0)
    silent = [_find_rebound(engine, "URDF", 0.0), _find_rebound(engine, "URDF", 0.8, threshold=1e5)]
    yield deviation(engine, "rebound without e, or below the threshold", "", silent, 0.03)


def _find_rebound(engine: str, kind: str, restitution: float, threshold: float = 0.0) -> float:
    """Drop a ball, or a box; find the ratio of the speeds after and before the impact."""
    radius, bounce = HALF_M, write_bounce(restitution, threshold)
    if kind == "flat":
        text = write_box(tags=f"<collision>{bounce}</collision>")
    else:
        text = write_ball(radius, bounce=bounce, kind=kind)
    with open_scene(engine) as scene:
        body = scene.spawn(text, (0.0, 0.0, radius + DROP_M))
        before, after = 0.0, 0.0
        for _ in range(round(0.6 / scene.world.step_period)):
            scene.world.step()
            before, after = min(before, body.twist.vz), max(after, body.twist.vz)
    return -after / before


def _measure_stack(engine: str, time_s: float) -> Figure:
    """Find the greatest displacement of a box of a stack, and its sinking, after a time."""
    with open_scene(engine) as scene:
        places = [(0.0, 0.0, HALF_M * (1.0 + 2.0 * i)) for i in range(STACKED)]
        boxes = [scene.spawn(write_box(tags="<mu1>0.5</mu1>"), place) for place in places]
        scene.world.run_for(time_s)
        moved = [
            math.dist(place, box.pose[:3]) * MILLIMETRES
            for place, box in zip(places, boxes, strict=True)
        ]
    what = f"stack of {STACKED} boxes after {time_s:g} s: displacement"
    return deviation(engine, what, "mm", moved, 2.0)


def _measure_supports(engine: str) -> Figure:
    """Find how much of the weight of a bar two supports bear, each a plate on a spring."""
    with open_scene(engine) as scene:
        scales = [scene.spawn(_write_scale(), (x, 0.0, 0.2)) for x in SUPPORTS_M]
        scene.world.run_for(2.0)
        empty = [_read_joint(scene, scale) for scale in scales]
        scene.spawn(write_box((2.0, 0.1, 0.1), mass_kg=BAR_KG), (0.0, 0.0, 0.27))
        scene.world.run_for(4.0)
        loads = [
            (before - _read_joint(scene, scale)) * SPRING_N_PER_M
            for before, scale in zip(empty, scales, strict=True)
        ]
    left, right = SUPPORTS_M
    answers = [BAR_KG * G * right / (right - left), -BAR_KG * G * left / (right - left)]
    off = [(load / answer - 1.0) * 100.0 for load, answer in zip(loads, answers, strict=True)]
    return deviation(engine, "loads of a bar on two supports", "%", off, 0.5)


def _write_scale() -> str:
    plate = write_inertial(5.0, moments_of_box(5.0, (0.04, 0.4, 0.04)))
    return (
        f'<robot name="scale"><link name="world"/><link name="plate">{plate}<collision>'
        '<origin rpy="1.5707963267948966 0 0"/><geometry><cylinder radius="0.02" length="0.4"/>'
        '</geometry></collision></link><joint name="slide" '
        'type="prismatic"><parent link="world"/><child link="plate"/><axis xyz="0 0 1"/>'
        '<limit lower="-0.1" upper="0.1" effort="1000" velocity="10"/><dynamics damping="2000"/>'
        f'</joint><gazebo reference="slide"><springStiffness>{SPRING_N_PER_M!r}</springStiffness>'
        "</gazebo></robot>"
    )


def _read_joint(scene: Scene, scale: Robot) -> float:
    view = scene.world.view
    return float(view.joint_positions[view.joints_of(scale.name)][0])

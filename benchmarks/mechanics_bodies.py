"""Moments, spin and fixed bodies, against the textbook."""

import math
from collections.abc import Iterator

import numpy as np

from benchmarks.figures import Figure
from benchmarks.mechanics_scene import (
    MILLIMETRES,
    Scene,
    Vector,
    deviation,
    moments_of_box,
    open_scene,
    write_box,
)
from zensim import Robot
from zensim.proto.se3 import FloatArray, rotate

SHAPES: dict[str, Vector] = {
    "cube": (0.3, 0.3, 0.3),
    "plate": (0.6, 0.4, 0.05),
    "rod": (1.0, 0.06, 0.06),
}
SHARES = (1.0, 0.1, 0.01, 0.001)
CRATE_KG = 5.0
TOP: Vector = (0.01, 0.01, 0.018)
UNEQUAL: Vector = (0.01, 0.02, 0.028)
IMPOSSIBLE: dict[str, tuple[Vector, Vector]] = {
    "1, 1, 3": ((0.01, 0.01, 0.03), (4 / 300, 4 / 300, 8 / 300)),
    "1, 1, -1": ((0.01, 0.01, -0.01), (0.01, 0.01, 0.0)),
}
"""Moments as written, and the nearest ones of a body."""
BOX_M = 0.2


def rows(engine: str, *, is_short: bool) -> Iterator[Figure]:
    """Measure each situation in one engine."""
    yield from _measure_rests(engine, 5.0 if is_short else 60.0)
    yield from _measure_precession(engine)
    for rate in (5.0, 20.0):
        yield from _measure_tumbling(engine, rate)
    yield from _measure_fixed(engine)


def _measure_rests(engine: str, time_s: float) -> Iterator[Figure]:
    """Let bodies rest whose moments are a share of their shape's."""
    for name, size in SHAPES.items():
        sunk, crept = [], []
        for share in SHARES:
            xx, yy, zz = moments_of_box(CRATE_KG, size)
            text = write_box(size, mass_kg=CRATE_KG, moments=(share * xx, share * yy, share * zz))
            with open_scene(engine) as scene:
                body = scene.spawn(text, (0.0, 0.0, size[2] / 2.0))
                scene.world.run_for(1.0)
                start = body.pose
                scene.world.run_for(time_s)
                end = body.pose
            sunk.append((size[2] / 2.0 - min(start.z, end.z)) * MILLIMETRES)
            crept.append(math.dist(start[:3], end[:3]) * MILLIMETRES)
        what = f"{name} with 1 to 1/1000 of its moments"
        yield deviation(engine, f"{what}: sinks", "mm", sunk, 0.5)
        yield deviation(engine, f"{what}: creeps in {time_s:g} s", "mm", crept, 1.0)


def _measure_precession(engine: str) -> Iterator[Figure]:
    """Measure the rate at which the axis of a top turns: its momentum over the moment across."""
    yield deviation(
        engine, "rate of a free top's axis", "%", [_find_precession_error(engine, TOP, TOP)], 1.0
    )
    written, nearest = IMPOSSIBLE["1, 1, 3"]
    error = _find_precession_error(engine, written, nearest)
    yield deviation(engine, "the same with moments 1, 1, 3, as 4/3, 4/3, 8/3", "%", [error], 1.0)


def _find_precession_error(engine: str, written: Vector, used: Vector) -> float:
    spin = (1.0, 0.0, 5.0)
    momentum = np.array(used) * np.array(spin)
    answer = float(np.linalg.norm(momentum)) / used[0]
    with open_scene(engine) as scene:
        body = _spawn_spinning(scene, written, spin)
        turned, before = 0.0, None
        start = scene.world.time
        while scene.world.time - start < 5.0:
            scene.world.step(2)
            phase = _find_phase(_find_axis(body), momentum)
            if before is not None:
                turned += (phase - before + math.pi) % math.tau - math.pi
            else:
                start = scene.world.time
            before = phase
        rate = abs(turned) / (scene.world.time - start)
    return (rate / answer - 1.0) * 100.0


def _spawn_spinning(scene: Scene, moments: Vector, spin: Vector) -> Robot:
    """Spawn a box without gravity and collisions nearby, and let it spin."""
    text = write_box(moments=moments, tags="<gravity>false</gravity>")
    body = scene.spawn(text, (0.0, 0.0, 5.0))
    scene.push(body, (0.0, 0.0, 0.0), spin)
    return body


def _find_axis(body: Robot) -> FloatArray:
    return rotate(np.array(body.pose[3:]), np.array([0.0, 0.0, 1.0]))


def _find_phase(axis: FloatArray, momentum: FloatArray) -> float:
    """Find the angle of an axis about the momentum."""
    along = momentum / np.linalg.norm(momentum)
    first = np.cross(along, [0.0, 1.0, 0.0])
    first /= np.linalg.norm(first)
    return math.atan2(float(axis @ np.cross(along, first)), float(axis @ first))


def _measure_tumbling(engine: str, rate: float) -> Iterator[Figure]:
    """Measure momentum and energy of a body that turns about its middle axis, for 10 s."""
    spin = (0.01 * rate, rate, 0.01 * rate)
    inertia = np.array(UNEQUAL)
    momenta, energies, least = [], [], 0.0
    with open_scene(engine) as scene:
        step_s = scene.world.step_period
        body = _spawn_spinning(scene, UNEQUAL, spin)
        for _ in range(200):
            scene.world.run_for(0.05)
            own = np.array(body.twist.angular)
            momenta.append(rotate(np.array(body.pose[3:]), inertia * own))
            energies.append(float(inertia @ own**2) / 2.0)
            least = min(least, float(own[1]))
    start = inertia * np.array(spin)
    energy = float(start @ np.array(spin)) / 2.0
    lost = [float(np.linalg.norm(one - start) / np.linalg.norm(start)) * 100.0 for one in momenta]
    what = f"tumbling at {rate:g} rad/s for 10 s"
    # The velocity is that of the middle of the step before the pose.
    yield deviation(engine, f"{what}: momentum", "%", lost, 50.0 * rate * step_s)
    yield deviation(engine, f"{what}: energy", "%", [(e / energy - 1) * 100 for e in energies], 0.5)
    yield deviation(
        engine, f"{what}: turns over about its middle axis", "%", [(least / rate + 1) * 100], 2.0
    )


def _measure_fixed(engine: str) -> Iterator[Figure]:
    """Measure where a body that is fixed to the world stands, by a ball that rests on it."""
    offset, height = (0.3, 0.2, 0.5), 1.0
    urdf = (
        '<robot name="post"><link name="world"/><link name="post"><inertial><mass value="1"/>'
        '<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial>'
        f'<collision><geometry><box size="{BOX_M} {BOX_M} {BOX_M}"/></geometry></collision></link>'
        '<joint name="fix" type="fixed"><parent link="world"/><child link="post"/>'
        '<origin xyz="0.3 0.2 0.5"/></joint></robot>'
    )
    sdf = (
        '<sdf version="1.9"><model name="post"><link name="post"><pose>0.3 0.2 0.5 0 0 0</pose>'
        "<inertial><mass>1</mass><inertia><ixx>0.01</ixx><iyy>0.01</iyy><izz>0.01</izz></inertia>"
        f'</inertial><collision name="c"><geometry><box><size>{BOX_M} {BOX_M} {BOX_M}</size></box>'
        '</geometry></collision></link><joint name="fix" type="fixed"><parent>world</parent>'
        "<child>post</child></joint></model></sdf>"
    )
    for kind, text in (("URDF", urdf), ("SDF", sdf)):
        found = []
        for yaw in (0.0, math.pi / 2.0):
            with open_scene(engine) as scene:
                post = scene.spawn(text, (1.0, 0.0, height), rpy=(0.0, 0.0, yaw))
                x = 1.0 + offset[0] * math.cos(yaw) - offset[1] * math.sin(yaw)
                y = offset[0] * math.sin(yaw) + offset[1] * math.cos(yaw)
                top = height + offset[2] + BOX_M / 2.0
                load = write_box((0.1, 0.1, 0.1), mass_kg=20.0)
                box = scene.spawn(load, (x, y, top + 0.06))
                scene.world.run_for(2.0)
                found += [box.pose.z - top - 0.05, box.pose.x - x, box.pose.y - y]
                found += [post.pose.x - 1.0, post.pose.y, post.pose.z - height]
        moved = [one * MILLIMETRES for one in found]
        yield deviation(engine, f"body fixed to world, under 20 kg, {kind}", "mm", moved, 0.5)

"""Casting

CPU of one core for scans and images of a hall of 20 x 20 m with 43 boxes, in which 100 robots (two
boxes and a round housing each) lean a little. Floor of a scan: the exact caster, ray by ray. The
sample is one turn over all robots, divided by their number; one frame for a camera. `worst
difference` is that from the exact caster over every ray of five lidars.
"""

import math
import time
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
import numpy.typing as npt

from benchmarks.figures import Figure, Limit, table
from zensim.proto.messages.model_messages import Link, Model, Origin, Shape
from zensim.proto.messages.sensor_messages import CameraSensor, RaySensor, ScanAxis
from zensim.proto.messages.world_messages import Scene
from zensim.proto.se3 import FloatArray, from_rpy
from zensim.sim_server.scene.camera_casting import RayRenderer
from zensim.sim_server.scene.camera_images import list_visible_shapes
from zensim.sim_server.scene.camera_selection import make_camera_renderer
from zensim.sim_server.scene.fleet_casting import FleetCaster
from zensim.sim_server.scene.ray_casting import PlacedShapes, cast_rays_exactly
from zensim.sim_server.scene.scan_casting import cast_ray_by_ray
from zensim.sim_server.scene.scene import SceneLayout
from zensim.sim_server.scene.scene_lights import SceneLights

__all__ = ["rows", "table"]

ROBOTS, BOXES, HALF_M, BARE_M = 100, 43, 9.8, 0.45
FEW = 5
"""Lidars that are compared with the exact caster."""
TURNS, TURNS_WHEN_SHORT = 30, 3
MILLISECONDS = 1e3
FLAT = RaySensor(ScanAxis(360, -math.pi, math.pi), range_max_m=10.0)
DEEP = RaySensor(ScanAxis(900, -math.pi, math.pi), ScanAxis(16, -0.26, 0.26), range_max_m=30.0)
DEPTH = CameraSensor("depth", width=320, height=240)
COLOUR = CameraSensor("rgbd", width=640, height=480)
NO_JOINTS = np.zeros(0)


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Measure lidars, then cameras."""
    turns = TURNS_WHEN_SHORT if is_short else TURNS
    layout, base = make_hall()
    yield from _lidar_figures(layout, base, turns)
    yield from _camera_figures(layout, base, turns)


def make_hall() -> tuple[SceneLayout, FloatArray]:
    """Place boxes, walls, and robots clear of them and of each other; robots come last."""
    rng = np.random.default_rng(5)
    sizes = rng.uniform(0.4, 1.6, (BOXES, 3))
    boxes = np.column_stack([rng.uniform(-HALF_M, HALF_M, (BOXES, 2)), np.zeros(BOXES)])
    walls = [(0.0, 10.1, 20.4, 0.2), (0.0, -10.1, 20.4, 0.2), (10.1, 0.0, 0.2, 20.4)]
    walls.append((-10.1, 0.0, 0.2, 20.4))
    models = [_make_box(*size) for size in sizes.tolist()]
    models += [_make_box(w, h, 1.0) for _, _, w, h in walls]
    places: list[FloatArray] = []
    while len(places) < ROBOTS:
        place = rng.uniform(-HALF_M + BARE_M, HALF_M - BARE_M, 2)
        is_clear = (np.abs(boxes[:, :2] - place) > sizes[:, :2] / 2.0 + BARE_M).any(axis=1).all()
        if is_clear and all(np.hypot(*(place - other)) > BARE_M for other in places):
            places.append(place)
    poses = [(x, y, z, 0.0, 0.0, 0.0, 1.0) for x, y, z in boxes.tolist()]
    poses += [(x, y, 0.0, 0.0, 0.0, 0.0, 1.0) for x, y, _, _ in walls]
    leans = rng.normal(0.0, 0.005, (ROBOTS, 2)).tolist()
    poses += [
        (*place.tolist(), 0.0, *from_rpy(lean[0], lean[1], rng.uniform(-3.0, 3.0)).tolist())
        for place, lean in zip(places, leans, strict=True)
    ]
    robot = Model(
        "robot",
        (
            Link(
                "base",
                collisions=(
                    Shape("box", (0.3, 0.24, 0.1), Origin((0.0, 0.0, 0.09))),
                    Shape("box", (0.1, 0.2, 0.1), Origin((0.0, 0.0, 0.19))),
                    Shape("cylinder", (0.045, 0.04, 0.0), Origin((0.1, 0.0, 0.16))),
                ),
            ),
        ),
    )
    layout = SceneLayout([*models, *[robot] * ROBOTS], _find_nothing, has_ground=True)
    return layout, np.array(poses)


def _make_box(x: float, y: float, z: float) -> Model:
    return Model("box", (Link("base", collisions=(Shape("box", (x, y, z)),)),), is_static=True)


def _find_nothing(_: str) -> FloatArray:
    return np.zeros((3, 3))


def _lidar_figures(layout: SceneLayout, base: FloatArray, turns: int) -> Iterator[Figure]:
    first = len(base) - ROBOTS
    carriers, sensors = np.arange(first, len(base)), base[first:].copy()
    sensors[:, 2] = 0.16
    fleet = FleetCaster(layout)

    def cast(settings: RaySensor, count: int) -> None:
        fleet.place(base, NO_JOINTS)
        fleet.cast(settings, sensors[:count], carriers[:count])

    yield Figure(
        what="level scan of 360 rays, 100 robots",
        unit="ms of CPU",
        samples=_spend(lambda: cast(FLAT, ROBOTS), turns, ROBOTS),
        limit=Limit("min", "<=", 0.25, is_timed=True),
    )
    yield Figure(
        what="scan of 16 x 900 rays, 1 robot",
        unit="ms of CPU",
        samples=_spend(lambda: cast(DEEP, 1), turns, 1),
        limit=Limit("min", "<=", 10.0, is_timed=True),
    )
    yield from _exactness_figures(fleet, layout.place(base, NO_JOINTS), sensors[:FEW], turns)


def _exactness_figures(
    fleet: FleetCaster, shapes: PlacedShapes, sensors: FloatArray, turns: int
) -> Iterator[Figure]:
    """Compare level lidars, which are the robots' that come last, with the exact caster."""
    carriers = np.arange(FEW) + (int(shapes.entity.max()) + 1 - ROBOTS)
    level = sensors.copy()
    level[:, 3:5] = 0.0
    level[:, 3:] /= np.linalg.norm(level[:, 3:], axis=1, keepdims=True)

    def cast_exactly() -> FloatArray:
        return cast_ray_by_ray(cast_rays_exactly, shapes, FLAT, level, carriers)

    yield Figure(
        what="floor: level scan ray by ray, exact",
        unit="ms of CPU",
        samples=_spend(cast_exactly, max(turns // 10, 1), FEW),
    )
    found, exact = fleet.cast(FLAT, level, carriers), cast_exactly()
    is_hit = np.isfinite(exact) & np.isfinite(found)
    worst = np.abs(found[is_hit] - exact[is_hit]).max(initial=0.0)
    lost = (np.isfinite(exact) != np.isfinite(found)).sum()
    yield Figure(
        what="level scan: worst difference",
        unit="m",
        samples=(float(worst),),
        limit=Limit("max", "<=", 1e-6),
    )
    yield Figure(
        what="level scan: rays that see another thing",
        unit="",
        samples=(float(lost),),
        limit=Limit("max", "<=", 0.0),
    )


class NoTextures:
    """Textures of a hall that has none."""

    def find_picture(self, _: str) -> None:
        """Find nothing."""

    def find_places(self, _: str) -> npt.NDArray[np.float32]:
        """Find nothing."""
        return np.zeros((0, 2), np.float32)


def _camera_figures(layout: SceneLayout, base: FloatArray, turns: int) -> Iterator[Figure]:
    models = [group.model for group in layout.groups for _ in group.rows]
    seen = SceneLayout(
        models,
        _find_nothing,
        has_ground=True,
        list_shapes=lambda link: list_visible_shapes(link, lambda _: True) or link.collisions,
    )
    pose = base[-1].copy()
    pose[2] = 0.3
    for name, renderer in (
        ("", make_camera_renderer(seen, NoTextures())),
        (" by rays", RayRenderer(seen)),
    ):
        lighting = SceneLights(seen, Scene()).place(base, NO_JOINTS)
        renderer.place(seen.place(base, NO_JOINTS), lighting)
        for label, settings, limit_ms in (
            ("320 x 240", DEPTH, 50.0 if name else 1000.0 / 30.0),
            ("640 x 480", COLOUR, None if name else 1000.0 / 15.0),
        ):
            yield Figure(
                what=f"colour, depth and labels of {label}{name}",
                unit="ms of CPU",
                samples=_spend(partial(renderer.render, settings, pose), turns, 1),
                limit=None if limit_ms is None else Limit("min", "<=", limit_ms, is_timed=True),
            )


def _spend(work: Callable[[], object], turns: int, count: int) -> tuple[float, ...]:
    """Measure the CPU time of one of `count` parts of the work [ms], after a turn to warm up."""
    work()
    samples = []
    for _ in range(turns):
        start_s = time.process_time()
        work()
        samples.append((time.process_time() - start_s) / count * MILLISECONDS)
    return tuple(samples)

"""State to render: link poses of a snapshot, grouped by visual template. NumPy only."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import islice
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from zensim.proto.messages.agent_messages import STATE_COLUMNS
from zensim.proto.messages.model_messages import Light, Model, Origin
from zensim.proto.messages.telemetry_messages import EntityModel, GetModelsResponse, Snapshot, Stats
from zensim.proto.messages.world_messages import Scene
from zensim.proto.rigid_transforms import compose, rotate
from zensim.proto.se3 import FloatArray, from_origin, to_yaw, transform_points
from zensim.proto.se3 import compose as compose_poses
from zensim.spawner.page.model_bounds import ModelBounds
from zensim.spawner.page.model_visuals import (
    NO_MESHES,
    Array,
    NotATree,
    TriangleMeshes,
    VisualTemplate,
    find_link_poses,
    make_shape_mesh,
    make_template,
)
from zensim.spawner.page.robot_colours import find_robot_colour, to_linear
from zensim.spawner.page.sensor_views import SensorChoice, SensorView, list_sensor_views

MAX_MODEL_LIGHTS: Final = 8
MOVING_MPS: Final = 0.01
MOVING_RADPS: Final = 0.02
"""Speeds from which an entity moves; engines leave slower residues."""
FRESH_S: Final = 1.0
"""A command of this age or older drives nothing."""
WIDE_AZIMUTH_RAD: Final = np.radians(28.0)
"""Angle of the view to the long side of the fleet: along it, so that the nearest are large."""
NARROW_AZIMUTH_RAD: Final = np.radians(14.0)
"""The same where the image is higher than wide, as on a phone."""
VIEW_ELEVATION_RAD: Final = np.radians(20.0)
HIGH_ELEVATION_RAD: Final = np.radians(42.0)
"""Elevation of a view into a world, whose walls would hide what is behind them."""
SURROUNDINGS_M: Final = 1.0
"""What is shown around robots among walls."""
TALL_M: Final = 0.2
"""A static model that rises less above a robot hides none."""
FLAT_M: Final = 0.1
"""A lower static model is a floor, which may be much larger than what stands on it."""
LEAST_VIEW_M: Final = 1.2
"""Least width of a view: a single robot has floor around it."""
VIEW_MARGIN_M: Final = 0.4
"""Margin around each robot, which may drive."""
LEAST_DISTANCE_M: Final = 0.7
"""Least distance of the nearest point along the axis of the camera."""
FILLED_WIDTH, FILLED_HEIGHT = 0.92, 0.82
"""Shares of the image that the outermost points may span."""
BISECTIONS: Final = 40
PHONE_ASPECT: Final = 0.7
"""Width / height of the image below which controls are a sheet at its bottom."""
SHEET_SHARE: Final = 0.48
"""Share of the height that the sheet of controls covers at the bottom of a narrow image."""


class UnknownEntity(Exception):
    """A snapshot has an entity without a known model."""


class MismatchedSnapshot(Exception):
    """The sizes of the arrays of a snapshot do not match its models."""


class InstanceGroup(msgspec.Struct, frozen=True, eq=False):
    """The entities that share one template."""

    template: VisualTemplate
    names: tuple[str, ...]
    rows: np.ndarray
    """(k,), rows of `Snapshot.base`."""
    joint_columns: np.ndarray
    """(k, joints), indices into `Snapshot.joint_positions`."""
    colours: NDArray[np.uint8] | None
    """(k, 3) of the bodies, linear; None without a drive: those of the model."""


class RenderedFleet(msgspec.Struct, frozen=True, eq=False):
    """All entities, grouped by template."""

    names: tuple[str, ...] = ()
    groups: tuple[InstanceGroup, ...] = ()
    members: dict[str, EntityModel] = {}
    templates: dict[str, VisualTemplate] = {}
    robots: tuple[str, ...] = ()
    """Entities with a drive, or controlled joints."""
    rows: dict[str, int] = {}
    """Row of each entity in `RenderedFrame.base`."""
    joints: int = 0
    """Number of joints of all entities."""
    meshes: TriangleMeshes = NO_MESHES
    """Meshes of the templates."""
    scene: Scene = Scene()
    """Scene of the world, without the lights of models."""
    sensors: dict[SensorChoice, SensorView] = {}
    """What can be shown of the sensors of all entities."""
    models: tuple[Model, ...] = ()
    """Models, which `EntityModel.model` indexes."""
    driven: frozenset[str] = frozenset()
    """Robots with a drive."""

    def model_of(self, name: str) -> Model:
        """Return the model of an entity."""
        return self.models[self.members[name].model]


class RenderedFrame(msgspec.Struct, frozen=True, eq=False):
    """One snapshot, ready to draw."""

    base: Array = msgspec.field(default_factory=lambda: np.zeros((0, STATE_COLUMNS)))
    """(n, STATE_COLUMNS), in the order of `RenderedFleet.names`."""
    links: tuple[tuple[FloatArray, ...], ...] = ()
    """Poses (k, 7) of every link of every group."""
    lights: tuple[Light, ...] = ()
    """Lights of links, in the world frame; at most `MAX_MODEL_LIGHTS`."""


class SimulationStatus(msgspec.Struct, frozen=True):
    """State of the simulation for the side panel."""

    state: str = "no server"
    sim_time_s: float = 0.0
    real_time_factor: float = 0.0
    robots: int = 0
    entities: int = 0
    malformed: int = 0
    """Messages of shown sensors that could not be read."""
    stats: Stats | None = None
    """Newest of the server."""


class LastCommand(msgspec.Struct, frozen=True):
    """Last velocity command of a robot."""

    forward_mps: float
    turn_radps: float
    age_s: float

    @property
    def is_fresh(self) -> bool:
        """Whether it still drives the robot."""
        return self.age_s < FRESH_S


def make_fleet(
    names: tuple[str, ...], models: GetModelsResponse, meshes: TriangleMeshes = NO_MESHES
) -> RenderedFleet:
    """Group entities by template.

    Args:
        names: Entities of a snapshot.
        models: Models of all entities.
        meshes: Available meshes.

    Raises:
        UnknownEntity: A name has no model.
        MismatchedSnapshot: A model is not a tree.
    """
    members = {member.entity: member for member in models.entities}
    templates = _find_templates(names, models, meshes)
    views = [list_sensor_views(model) for model in models.models]
    model_of = {name: models.models[members[name].model] for name in names}
    robots = tuple(name for name, model in model_of.items() if model.is_robot)
    counts = [len(template.visual_joints) for template in templates.values()]
    starts = np.cumsum([0, *counts])
    driven = frozenset(name for name in robots if model_of[name].drive is not None)
    return RenderedFleet(
        names=names,
        groups=tuple(
            _make_group(one, [names[row] for row in own], np.array(own), starts, driven)
            for one, own in _group_rows(templates.values()).items()
        ),
        members=members,
        templates=templates,
        robots=robots,
        rows={name: row for row, name in enumerate(names)},
        joints=int(starts[-1]),
        meshes=meshes,
        scene=models.scene,
        sensors={SensorChoice(n, v.topic): v for n in names for v in views[members[n].model]},
        models=models.models,
        driven=driven,
    )


def _group_rows(templates: Iterable[VisualTemplate]) -> dict[VisualTemplate, list[int]]:
    rows: dict[VisualTemplate, list[int]] = {}
    for row, template in enumerate(templates):
        rows.setdefault(template, []).append(row)
    return rows


def _find_templates(
    names: tuple[str, ...], models: GetModelsResponse, meshes: TriangleMeshes
) -> dict[str, VisualTemplate]:
    members = {member.entity: member for member in models.entities}
    try:
        templates = [make_template(model, meshes) for model in models.models]
        return {name: templates[members[name].model] for name in names}
    except (KeyError, IndexError) as error:
        raise UnknownEntity(f"entity {error} has no model") from error
    except NotATree as error:
        raise MismatchedSnapshot(str(error)) from error


def make_frame(fleet: RenderedFleet, snapshot: Snapshot) -> RenderedFrame:
    """Compute the poses of all links.

    Raises:
        MismatchedSnapshot: An array has another size or a number that is not finite.
    """
    base = _read_numbers(snapshot.base, len(fleet.names) * STATE_COLUMNS, "base")
    joints = _read_numbers(snapshot.joint_positions, fleet.joints, "joint_positions")
    states = base.reshape(-1, STATE_COLUMNS)
    links = tuple(
        tuple(
            find_link_poses(
                group.template.visual_joints, states[group.rows, :7], joints[group.joint_columns]
            )
        )
        for group in fleet.groups
    )
    return RenderedFrame(
        states, links, tuple(islice(_place_lights(fleet, links), MAX_MODEL_LIGHTS))
    )


def find_sensor_pose(
    fleet: RenderedFleet, frame: RenderedFrame, choice: SensorChoice
) -> FloatArray:
    """Find the pose (7,) of a sensor of the fleet in the world frame."""
    view, row = fleet.sensors[choice], fleet.rows[choice.entity]
    place, links = next(
        (int(np.argmax(group.rows == row)), links)
        for group, links in zip(fleet.groups, frame.links, strict=True)
        if row in group.rows
    )
    return compose_poses(links[view.link][place], from_origin(view.origin))


def _place_lights(
    fleet: RenderedFleet, links: tuple[tuple[FloatArray, ...], ...]
) -> Iterator[Light]:
    for group, poses in zip(fleet.groups, links, strict=True):
        for number, lights in enumerate(group.template.lights):
            for light in lights:
                for pose in poses[number].tolist():
                    yield _place_light(light, Origin(tuple(pose[:3]), tuple(pose[3:])))


def _place_light(light: Light, link: Origin) -> Light:
    return msgspec.structs.replace(
        light,
        origin=compose(link, light.origin),
        direction=rotate(link.orientation, light.direction),
    )


Instances = tuple[VisualTemplate, np.ndarray, tuple[FloatArray, ...]]
"""Template, places of entities in its group, and poses (k, 7) of each link of the group."""


def select_instances(
    fleet: RenderedFleet, frame: RenderedFrame, names: Sequence[str]
) -> list[Instances]:
    """Select entities, by their templates."""
    rows = np.array([fleet.rows[name] for name in names], dtype=np.intp)
    found = []
    for group, links in zip(fleet.groups, frame.links, strict=True):
        places = np.flatnonzero(np.isin(group.rows, rows))
        if len(places):
            found.append((group.template, places, links))
    return found


def list_link_poses(fleet: RenderedFleet, frame: RenderedFrame, names: Sequence[str]) -> FloatArray:
    """List the poses (n, 7) of all links of entities in the world."""
    poses = [
        pose[places] for _, places, links in select_instances(fleet, frame, names) for pose in links
    ]
    return np.concatenate([np.zeros((0, 7)), *poses])


class View(msgspec.Struct, frozen=True, eq=False):
    """What a camera shows."""

    points: Array
    """(n, 3) in the world frame; n > 0."""
    elevation_rad: float = VIEW_ELEVATION_RAD
    """Angle by which the camera looks down."""


def choose_view(
    fleet: RenderedFleet, frame: RenderedFrame, find_bounds: Callable[[VisualTemplate], ModelBounds]
) -> View:
    """Choose a view of the robots, or of the whole world if there are none.

    Args:
        fleet: Not empty.
        frame: Of the fleet.
        find_bounds: Finds the box around a template.
    """
    boxes = {
        name: frame.base[fleet.rows[name], :3] + find_bounds(fleet.templates[name]).at_rest
        for name in fleet.names
    }
    robots = set(fleet.robots)
    others = [box for name, box in boxes.items() if name not in robots]
    solids = [box for box in others if np.ptp(box[:, 2]) > FLAT_M]
    if not robots:
        return View(np.concatenate(solids or others), HIGH_ELEVATION_RAD)
    points = frame.base[[fleet.rows[name] for name in fleet.robots], :3]
    walls = (name for name in fleet.names if name not in robots)
    if not any(_hides(name, boxes[name], fleet, frame, points) for name in walls):
        return View(np.concatenate([_surround(boxes[name]) for name in fleet.robots]))
    around = (points + offset for offset in _make_corners(SURROUNDINGS_M) * (1.0, 1.0, 0.0))
    return View(np.concatenate([*around]), HIGH_ELEVATION_RAD)


def _hides(
    name: str, box: Array, fleet: RenderedFleet, frame: RenderedFrame, points: Array
) -> bool:
    """Whether a part of a model is so high and near that it may hide a robot in a low view."""
    first, *rest = fleet.templates[name].links
    if rest or any(shape.kind == "mesh" for shape in first):
        parts = [box]
    else:
        corners = (
            transform_points(from_origin(shape.origin), make_shape_mesh(shape).vertices)
            for shape in first
        )
        base = frame.base[fleet.rows[name], :7]
        placed = [transform_points(base, one) for one in corners]
        parts = [np.stack([one.min(axis=0), one.max(axis=0)]) for one in placed]
    low, high = np.stack(parts, axis=1)[:, :, None]
    gaps = np.maximum(np.maximum(low - points, points - high), 0.0)[..., :2]
    rises = high[..., 2] - points[:, 2]
    is_near = np.linalg.norm(gaps, axis=-1) * np.tan(VIEW_ELEVATION_RAD) < rises
    return bool((is_near & (rises > TALL_M)).any())


def _surround(box: Array) -> Array:
    """Make the corners (8, 3) of a box that holds another in every yaw about its middle."""
    middle, half = box.mean(axis=0), (box[1] - box[0]) / 2.0
    radius = float(np.hypot(half[0], half[1])) + VIEW_MARGIN_M
    corners: Array = middle + _make_corners(1.0) * (radius, radius, half[2])
    return corners


def fit_camera(view: View, *, aspect: float, fov_rad: float) -> tuple[Array, Array]:
    """Find camera position and target point so that the points fill the image.

    They span `FILLED_WIDTH` of its width, or less if they would then exceed `FILLED_HEIGHT`. The
    target is at the height of the middle of the points, if the camera is above it.

    Args:
        view: What to show.
        aspect: Width / height of the image.
        fov_rad: Vertical field of view.
    """
    low, high = view.points.min(axis=0), view.points.max(axis=0)
    centre = (low + high) / 2.0
    points = view.points - centre
    if (high - low)[:2].max() < LEAST_VIEW_M:
        least = _make_corners(LEAST_VIEW_M / 2.0) * (1.0, 1.0, 0.0)
        points = np.concatenate((points, least))
    azimuth = WIDE_AZIMUTH_RAD if aspect >= 1.0 else NARROW_AZIMUTH_RAD
    right, up, ahead = _find_view_axes(high - low, azimuth, view.elevation_rad)
    half_height = float(np.tan(fov_rad / 2.0))
    along = points @ ahead
    # On a phone the page has the axis of the camera in the middle of what its sheet leaves free.
    covered = SHEET_SHARE if aspect < PHONE_ASPECT else 0.0
    sideways, upward = points @ right, points @ up
    depth = min(
        _find_depth(sideways, along, FILLED_WIDTH * half_height * aspect),
        _find_depth(upward, along, FILLED_HEIGHT * (1.0 - covered) * half_height),
        float(along.min()) - LEAST_DISTANCE_M,
    )
    across = _find_middle(sideways, along - depth)
    above = _find_middle(upward, along - depth)
    offset = across * right + above * up + depth * ahead
    reach = max(float(-offset[2] / ahead[2]), LEAST_DISTANCE_M)
    return centre + offset, centre + offset + reach * ahead


def _find_depth(across: Array, along: Array, slope: float) -> float:
    """Find how far along its axis a camera may stand that sees all points within +-slope of it.

    Args:
        across: Coordinate of each point along the edge of the image.
        along: Coordinate of each point along the axis of the camera.
        slope: Tangent of half the angle; > 0.
    """
    left = float(np.min(slope * along - across))
    right = float(np.min(slope * along + across))
    return (right + left) / (2.0 * slope)


def _find_middle(across: Array, distance: Array) -> float:
    """Find where a camera sees the outermost points equally far from its axis.

    Args:
        across: Coordinate of each point along the edge of the image.
        distance: Of each point along the axis of the camera; > 0.
    """
    low, high = 0.0, float(np.max(np.ptp(across) / distance))
    for _ in range(BISECTIONS):
        slope = (low + high) / 2.0
        is_enough = np.max(across - slope * distance) <= np.min(across + slope * distance)
        low, high = (low, slope) if is_enough else (slope, high)
    middle = np.max(across - high * distance) + np.min(across + high * distance)
    return float(middle) / 2.0


def is_moving(state: Array) -> bool:
    """Whether an entity with this state (STATE_COLUMNS,) moves faster than residues of engines."""
    return bool(
        np.linalg.norm(state[7:10]) >= MOVING_MPS or np.linalg.norm(state[10:13]) >= MOVING_RADPS
    )


def format_state(state: Array) -> tuple[str, str, str]:
    """Format position, heading and speed of a base state (STATE_COLUMNS,)."""
    # Adding 0.0 removes the sign of -0.0.
    x, y, z, speed, turn = np.round((*state[:3], np.linalg.norm(state[7:9]), state[12]), 2) + 0.0
    yaw = np.round(np.degrees(to_yaw(state[3:7]))) + 0.0
    return (
        f"x {x:.2f}  y {y:.2f}  z {z:.2f} m",
        f"{yaw:.0f}°",
        f"{speed:.2f} m/s  {turn:.2f} rad/s",
    )


def _make_group(
    template: VisualTemplate,
    names: Sequence[str],
    rows: np.ndarray,
    starts: np.ndarray,
    driven: frozenset[str],
) -> InstanceGroup:
    columns = starts[rows][:, None] + np.arange(len(template.visual_joints))
    colours = to_linear([find_robot_colour(name) for name in names])
    is_driven = not driven.isdisjoint(names)
    return InstanceGroup(template, tuple(names), rows, columns, colours if is_driven else None)


def _read_numbers(payload: bytes, count: int, what: str) -> Array:
    if len(payload) != 8 * count:
        raise MismatchedSnapshot(f"{what} has {len(payload)} bytes, expected {8 * count}")
    numbers = np.frombuffer(payload, dtype="<f8")
    if not np.isfinite(numbers).all():
        raise MismatchedSnapshot(f"{what} has a number that is not finite")
    return numbers


def _find_view_axes(
    extent: Array, azimuth_rad: float, elevation_rad: float
) -> tuple[Array, Array, Array]:
    """Find right, up and ahead of a camera that looks down, at an angle to the long side."""
    azimuth = azimuth_rad if extent[0] >= extent[1] else np.pi / 2.0 - azimuth_rad
    flat = np.cos(elevation_rad)
    ahead = np.array((flat * np.cos(azimuth), flat * np.sin(azimuth), -np.sin(elevation_rad)))
    right = np.array((np.sin(azimuth), -np.cos(azimuth), 0.0))
    return right, np.cross(right, ahead), ahead


def _make_corners(half: float) -> Array:
    return half * np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])

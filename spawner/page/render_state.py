"""What the page renders: models and a snapshot as poses, grouped by visual template. NumPy only."""

from typing import Final

import msgspec
import numpy as np

from zensim.proto.messages.agent_messages import STATE_COLUMNS
from zensim.proto.messages.telemetry_messages import EntityModel, GetModelsResponse, Snapshot
from zensim.proto.messages.world_messages import Scene
from zensim.proto.se3 import FloatArray, to_yaw
from zensim.spawner.page.model_visuals import (
    NO_MESHES,
    Array,
    NotATree,
    TriangleMeshes,
    VisualTemplate,
    find_link_poses,
    make_template,
)

VIEW_AZIMUTH_RAD: Final = np.radians(20.0)
"""How far the view is turned from the long side of the fleet: a row then runs into the depth."""
VIEW_ELEVATION_RAD: Final = np.radians(17.0)
VIEW_MARGIN_M: Final = 0.2
"""Around the outermost robots."""


class UnknownEntity(Exception):
    """A snapshot names an entity whose model is not known yet."""


class MismatchedSnapshot(Exception):
    """A snapshot's arrays do not fit its names and their models."""


class InstanceGroup(msgspec.Struct, frozen=True, eq=False):
    """The entities that share one form."""

    form: VisualTemplate
    names: tuple[str, ...]
    rows: np.ndarray
    """(k,), rows of `Snapshot.base`."""
    joint_columns: np.ndarray
    """(k, joints), indices into `Snapshot.joint_positions`."""


class RenderedFleet(msgspec.Struct, frozen=True, eq=False):
    """Everybody in the world, form by form."""

    names: tuple[str, ...] = ()
    groups: tuple[InstanceGroup, ...] = ()
    members: dict[str, EntityModel] = {}
    forms: dict[str, VisualTemplate] = {}
    robots: tuple[str, ...] = ()
    """The entities that have a drive."""
    rows: dict[str, int] = {}
    """Where an entity is in `RenderedFrame.base`."""
    joints: int = 0
    """Of all entities."""
    meshes: TriangleMeshes = NO_MESHES
    """Those that forms name."""
    scene: Scene = Scene()


class RenderedFrame(msgspec.Struct, frozen=True, eq=False):
    """One snapshot, ready to be drawn."""

    base: Array = msgspec.field(default_factory=lambda: np.zeros((0, STATE_COLUMNS)))
    """(n, STATE_COLUMNS), in the order of `RenderedFleet.names`."""
    links: tuple[tuple[FloatArray, ...], ...] = ()
    """Poses of every link of every cohort."""


class SimulationStatus(msgspec.Struct, frozen=True):
    """The simulation in one line."""

    state: str = "no server"
    sim_time_s: float = 0.0
    real_time_factor: float = 0.0
    robots: int = 0
    entities: int = 0


class LastCommand(msgspec.Struct, frozen=True):
    """What a robot was told last."""

    forward_mps: float
    turn_radps: float
    age_s: float


def make_fleet(
    names: tuple[str, ...], models: GetModelsResponse, meshes: TriangleMeshes = NO_MESHES
) -> RenderedFleet:
    """Sort entities by what they look like.

    Args:
        names: Of a snapshot.
        models: Of all of them.
        meshes: Those that are here, by sha256.

    Raises:
        UnknownEntity: A name has no model.
        MismatchedSnapshot: A model is not one.
    """
    members = {member.entity: member for member in models.entities}
    try:
        forms = [make_template(model, meshes) for model in models.models]
        forms_by_name = {name: forms[members[name].model] for name in names}
    except (KeyError, IndexError) as error:
        raise UnknownEntity(f"no model of {error}") from error
    except NotATree as error:
        raise MismatchedSnapshot(str(error)) from error
    counts = [len(form.visual_joints) for form in forms_by_name.values()]
    starts = np.cumsum([0, *counts])
    rows: dict[VisualTemplate, list[int]] = {}
    for row, form in enumerate(forms_by_name.values()):
        rows.setdefault(form, []).append(row)
    return RenderedFleet(
        names=names,
        groups=tuple(_make_group(form, names, np.array(of), starts) for form, of in rows.items()),
        members=members,
        forms=forms_by_name,
        robots=tuple(n for n in names if models.models[members[n].model].drive is not None),
        rows={name: row for row, name in enumerate(names)},
        joints=int(starts[-1]),
        meshes=meshes,
        scene=models.scene,
    )


def make_frame(fleet: RenderedFleet, snapshot: Snapshot) -> RenderedFrame:
    """Find where every link is.

    Raises:
        MismatchedSnapshot: Too few or too many numbers, or one that is not finite.
    """
    base = _read_numbers(snapshot.base, len(fleet.names) * STATE_COLUMNS, "base")
    joints = _read_numbers(snapshot.joint_positions, fleet.joints, "joint_positions")
    states = base.reshape(-1, STATE_COLUMNS)
    links = tuple(
        tuple(find_link_poses(c.form.visual_joints, states[c.rows, :7], joints[c.joint_columns]))
        for c in fleet.groups
    )
    return RenderedFrame(states, links)


def fit_camera(points: Array, *, aspect: float, fov_rad: float) -> tuple[Array, Array]:
    """Find a camera position and the point that it looks at, so that all points are in view.

    Args:
        points: (n, 3) in the world frame; n > 0.
        aspect: Width over height of the picture.
        fov_rad: Vertical field of view.
    """
    low, high = points.min(axis=0), points.max(axis=0)
    centre = (low + high) / 2.0
    right, up, ahead = _find_view_axes(high - low)
    offsets = np.stack([points - centre + corner for corner in _make_corners(VIEW_MARGIN_M)])
    half_height = np.tan(fov_rad / 2.0)
    distances = np.maximum(
        np.abs(offsets @ up) / half_height, np.abs(offsets @ right) / (half_height * aspect)
    )
    return centre - ahead * float(np.max(distances - offsets @ ahead)), centre


def format_pose(state: Array) -> tuple[str, str]:
    """Write a base state (STATE_COLUMNS,) as position and heading, and as speed."""
    x, y, z = state[:3]
    yaw = np.degrees(to_yaw(state[3:7]))
    speed, turn = np.linalg.norm(state[7:9]), state[12]
    return (
        f"x {x:.2f}  y {y:.2f}  z {z:.2f} m  yaw {yaw:.0f}°",
        f"{speed:.2f} m/s  {turn:.2f} rad/s",
    )


def _make_group(
    form: VisualTemplate, names: tuple[str, ...], rows: np.ndarray, starts: np.ndarray
) -> InstanceGroup:
    columns = starts[rows][:, None] + np.arange(len(form.visual_joints))
    return InstanceGroup(form, tuple(names[row] for row in rows), rows, columns)


def _read_numbers(payload: bytes, count: int, what: str) -> Array:
    if len(payload) != 8 * count:
        raise MismatchedSnapshot(f"{what} is {len(payload)} bytes; its models ask for {8 * count}")
    numbers = np.frombuffer(payload, dtype="<f8")
    if not np.isfinite(numbers).all():
        raise MismatchedSnapshot(f"{what} holds a number that is not finite")
    return numbers


def _find_view_axes(extent: Array) -> tuple[Array, Array, Array]:
    """Right, up and ahead of a camera that looks along the long side, from above."""
    azimuth = VIEW_AZIMUTH_RAD if extent[0] >= extent[1] else np.pi / 2.0 - VIEW_AZIMUTH_RAD
    flat = np.cos(VIEW_ELEVATION_RAD)
    ahead = np.array((flat * np.cos(azimuth), flat * np.sin(azimuth), -np.sin(VIEW_ELEVATION_RAD)))
    right = np.array((np.sin(azimuth), -np.cos(azimuth), 0.0))
    return right, np.cross(right, ahead), ahead


def _make_corners(half: float) -> Array:
    return half * np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])

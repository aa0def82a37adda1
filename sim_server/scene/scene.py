"""The scene: collision shapes of all entities at one step, the same for every engine and tier.

Shapes come from Models, poses from one reading of a step. A scene keeps its poses when the world
steps on. Queries return indices of entities, in the order of the models.
"""

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate

import numpy as np
import numpy.typing as npt

from zensim.proto.forward_kinematics import compute_link_poses
from zensim.proto.messages.model_messages import Link, Model, Shape
from zensim.proto.se3 import IDENTITY_POSE, FloatArray, compose, from_origin, to_matrix
from zensim.sim_server.scene.broad_phase import IntArray, are_beside, make_point_grid
from zensim.sim_server.scene.convex_shapes import (
    ConvexShape,
    MeshVertices,
    are_overlapping,
    find_bounding_radius,
    find_distance,
    list_collision_shapes,
    to_convex_shape,
)
from zensim.sim_server.scene.ray_casting import (
    GROUND,
    NO_ENTITY,
    PlacedShapes,
    RayCaster,
    RayHits,
    Rays,
    ShapeGeometry,
    cast_rays_exactly,
)

BoolArray = npt.NDArray[np.bool_]
FindTriangles = Callable[[str], npt.NDArray[np.floating]]
"""Finds the corners (3 f, 3) of the triangles of a `Shape.mesh`, unscaled."""

ListShapes = Callable[[Link], Sequence[Shape]]

ENTITIES_PER_TURN = 32
"""Entities of one model that are posed and tested at once."""
UNIT_LENGTH_TOLERANCE = 1e-9


@dataclass(frozen=True)
class Region:
    """A convex part of the world.

    Attributes:
        low: Lowest coordinates (3,).
        high: Highest coordinates (3,).
        is_box: Whether it is the whole box between them.
    """

    shape: ConvexShape
    low: FloatArray
    high: FloatArray
    is_box: bool = False


def make_region(solid: ConvexShape) -> Region:
    """Make a region of any shape."""
    low, high = solid.bounds_at(IDENTITY_POSE[None])
    return Region(solid, low[0], high[0])


@dataclass(frozen=True)
class ModelGroup:
    """The m entities of one model.

    Attributes:
        rows: (m,) indices of the entities.
        joints: (m, k) indices of their joint positions.
        is_fixed: Whether no link moves unless an entity is moved as a whole by a request.
    """

    model: Model
    rows: IntArray
    joints: IntArray
    is_fixed: bool


def place_collision_shapes(
    model: Model, base: FloatArray, joint_positions: FloatArray, vertices: MeshVertices
) -> list[tuple[ConvexShape, FloatArray]]:
    """List the collisions of a model in their link's frame, with poses (n, 7) of the link.

    Args:
        model: Common to n entities; planes are left out.
        base: Poses (n, 7) of their root links.
        joint_positions: (n, k).
        vertices: Finds the vertices of meshes.
    """
    links = compute_link_poses(model, base, joint_positions)
    return [(solid, links[link]) for link, solid in list_collision_shapes(model, vertices)]


def list_collisions(link: Link) -> tuple[Shape, ...]:
    """List the collisions of a link."""
    return link.collisions


class SceneLayout:
    """Entities and shapes of a scene: the part that lasts until the entity set changes.

    Attributes:
        groups: Entities by model.
        vertices: Finds the vertices of meshes, for hulls.
    """

    def __init__(
        self,
        models: Sequence[Model],
        vertices: MeshVertices,
        triangles: FindTriangles | None = None,
        *,
        has_ground: bool = False,
        list_shapes: ListShapes = list_collisions,
    ) -> None:
        """Group entities by model.

        Args:
            models: Of each entity, in the order of the state rows.
            vertices: Finds the vertices of meshes, for hulls.
            triangles: Finds the triangles of meshes, for rays; None = `vertices` has them.
            has_ground: Whether there is a ground plane z = 0.
            list_shapes: Lists the shapes of a link that rays hit.
        """
        counts = np.array([len(model.joints) for model in models], dtype=np.intp)
        starts = np.cumsum(counts) - counts
        # By identity: comparing models in full is slow.
        members: dict[int, list[int]] = {}
        for row, model in enumerate(models):
            members.setdefault(id(model), []).append(row)
        self.vertices = vertices
        self.groups = tuple(
            _make_group(models[rows[0]], np.array(rows, dtype=np.intp), starts)
            for rows in members.values()
        )
        self._triangles = triangles or vertices
        self._has_ground = has_ground
        self._list_shapes = list_shapes
        self._fixed: dict[int, tuple[FloatArray, FloatArray]] = {}
        self._fixed_part: tuple[FloatArray, PlacedShapes] | None = None
        """Poses of the fixed entities, and their shapes."""

    @cached_property
    def unplaced(self) -> PlacedShapes:
        """All shapes, group by group, entity after entity for each shape; without poses."""
        geometries: list[ShapeGeometry] = []
        geometry: list[IntArray] = []
        entity: list[IntArray] = []
        for group in self.groups:
            for shape in self._list_all(group.model):
                geometry.append(np.full(len(group.rows), len(geometries)))
                entity.append(group.rows)
                geometries.append(_make_geometry(shape, self._triangles))
        if self._has_ground:
            geometry.append(np.array([len(geometries)]))
            entity.append(np.array([GROUND]))
            geometries.append(_make_geometry(Shape("plane"), self._triangles))
        return PlacedShapes(
            tuple(geometries), _concatenate(geometry), _concatenate(entity), np.zeros((0, 7))
        )

    @cached_property
    def is_fixed(self) -> BoolArray:
        """Which of all shapes (s,) move only when a request moves their entity."""
        parts = [
            np.full(len(group.rows) * len(self._list_all(group.model)), group.is_fixed)
            for group in self.groups
        ]
        ground = np.ones(int(self._has_ground), np.bool_)
        return np.concatenate([np.zeros(0, np.bool_), *parts, ground])

    def place(self, base: FloatArray, joint_positions: FloatArray) -> PlacedShapes:
        """Find the poses of all shapes; those of fixed entities are kept while they stay."""
        poses = [np.zeros((0, 7))]
        for number, group in enumerate(self.groups):
            poses += self._place_group(number, group, base[group.rows, :7], joint_positions)
        if self._has_ground:
            poses.append(IDENTITY_POSE[None])
        shapes = self.unplaced
        return PlacedShapes(
            shapes.geometries, shapes.geometry, shapes.entity, np.concatenate(poses)
        )

    def place_fixed(self, base: FloatArray, joint_positions: FloatArray) -> PlacedShapes:
        """Place the shapes of fixed entities and the ground; the same object while they stay."""
        numbers = [number for number, group in enumerate(self.groups) if group.is_fixed]
        rows = _concatenate([self.groups[number].rows for number in numbers])
        known = self._fixed_part
        if known is None or not np.array_equal(known[0], base[rows, :7]):
            is_chosen = np.ones(len(base), np.bool_)
            parts = [self._place_part(one, base, joint_positions, is_chosen) for one in numbers]
            shapes = self._join(parts, has_ground=self._has_ground)
            known = self._fixed_part = base[rows, :7], shapes
        return known[1]

    def place_moving(
        self, base: FloatArray, joint_positions: FloatArray, is_chosen: BoolArray
    ) -> PlacedShapes:
        """Place the shapes of those entities that move and are chosen (n,)."""
        parts = [
            self._place_part(number, base, joint_positions, is_chosen)
            for number, group in enumerate(self.groups)
            if not group.is_fixed and is_chosen[group.rows].any()
        ]
        return self._join(parts, has_ground=False)

    def find_near(self, base: FloatArray, points: FloatArray, range_m: float) -> BoolArray:
        """Find the entities (n,) that move and may be within a range of points (m, 2).

        Others may be among them. Those that reach without limits always are, and those whose
        positions are not finite.
        """
        if not len(points):
            return np.zeros(len(self._radii), np.bool_)
        if not np.isfinite([range_m, *np.ptp(points, axis=0)]).all():
            return np.ones(len(self._radii), np.bool_)
        is_bounded = np.isfinite(self._radii)
        largest_m = float(self._radii.max(initial=0.0, where=is_bounded))
        grid = make_point_grid(points, range_m + largest_m)
        is_bounded &= np.isfinite(base[:, :2]).all(axis=1)
        return are_beside(grid, np.where(is_bounded[:, None], base[:, :2], 0.0)) | ~is_bounded

    @cached_property
    def _radii(self) -> FloatArray:
        """Radii (n,) [m] about the root links that hold all shapes of entities that move."""
        radii = np.zeros(sum(len(group.rows) for group in self.groups))
        for group in self.groups:
            if group.is_fixed:
                continue
            has_plane = any(shape.kind == "plane" for shape in self._list_all(group.model))
            found = np.inf if has_plane else find_bounding_radius(group.model, self.vertices)
            radii[group.rows] = found
        return radii

    @cached_property
    def _shape_ranges(self) -> tuple[tuple[int, int], ...]:
        """Index of the first shape of each group in the geometries, and its number of shapes."""
        counts = [len(self._list_all(group.model)) for group in self.groups]
        return tuple(zip(accumulate(counts, initial=0), counts, strict=False))

    def _place_part(
        self, number: int, base: FloatArray, joint_positions: FloatArray, is_chosen: BoolArray
    ) -> PlacedShapes:
        """Place the members of a group that are chosen (n,)."""
        group, (first, count) = self.groups[number], self._shape_ranges[number]
        is_member = is_chosen[group.rows]
        group = replace(group, rows=group.rows[is_member], joints=group.joints[is_member])
        poses = self._place_group(number, group, base[group.rows, :7], joint_positions)
        return PlacedShapes(
            self.unplaced.geometries,
            np.repeat(first + np.arange(count), len(group.rows)),
            np.tile(group.rows, count),
            np.concatenate([np.zeros((0, 7)), *poses]),
        )

    def _join(self, parts: Sequence[PlacedShapes], *, has_ground: bool) -> PlacedShapes:
        geometries, ground = self.unplaced.geometries, np.ones(int(has_ground), np.intp)
        return PlacedShapes(
            geometries,
            _concatenate([*(part.geometry for part in parts), ground * (len(geometries) - 1)]),
            _concatenate([*(part.entity for part in parts), ground * GROUND]),
            np.concatenate([*(part.poses for part in parts), IDENTITY_POSE[None][ground - 1]]),
        )

    def _place_group(
        self, number: int, group: ModelGroup, base: FloatArray, joint_positions: FloatArray
    ) -> list[FloatArray]:
        known = self._fixed.get(number)
        if known is not None and np.array_equal(known[0], base):
            return [known[1]]
        links = compute_link_poses(group.model, base, joint_positions[group.joints])
        poses = [
            compose(links[link.name], from_origin(shape.origin))
            for link in group.model.links
            for shape in self._list_shapes(link)
        ]
        if group.is_fixed:
            self._fixed[number] = base.copy(), np.concatenate([np.zeros((0, 7)), *poses])
        return poses

    def _list_all(self, model: Model) -> list[Shape]:
        return [shape for link in model.links for shape in self._list_shapes(link)]


class CollisionScene:
    """All collision shapes at one step."""

    def __init__(
        self,
        layout: SceneLayout,
        base: FloatArray,
        joint_positions: FloatArray,
        cast: RayCaster = cast_rays_exactly,
    ) -> None:
        """Take one reading.

        Args:
            layout: Of the same entities.
            base: (n, 7) or more columns: poses of the root links in the world; not copied.
            joint_positions: (k,) of all entities, in the order of `Model.joints`; not copied.
            cast: Finds the first hits of rays.
        """
        self._layout = layout
        self._base = base
        self._joint_positions = joint_positions
        self._cast = cast

    @cached_property
    def shapes(self) -> PlacedShapes:
        """All shapes in the world."""
        return self._layout.place(self._base, self._joint_positions)

    @property
    def is_fixed(self) -> BoolArray:
        """Which of the shapes (s,) move only when a request moves their entity."""
        return self._layout.is_fixed

    def cast_rays(
        self,
        origins: FloatArray,
        directions: FloatArray,
        max_range_m: float,
        ignored: IntArray | None = None,
    ) -> RayHits:
        """Find what rays hit first.

        Args:
            origins: (n, 3) in the world.
            directions: (n, 3), of unit length.
            max_range_m: Hits beyond it do not count.
            ignored: (n,) index of an entity that each ray passes through, or `NO_ENTITY`.

        Raises:
            ValueError: A direction is not of unit length.
        """
        lengths = np.linalg.norm(directions, axis=1)
        if not (np.abs(lengths - 1.0) <= UNIT_LENGTH_TOLERANCE).all():
            raise ValueError(f"directions have lengths from {lengths.min():g}; use unit vectors")
        if ignored is None:
            ignored = np.full(len(origins), NO_ENTITY, np.intp)
        return self._cast(self.shapes, Rays(origins, directions, max_range_m, ignored))

    def overlaps(self, region: Region) -> list[int]:
        """Find the entities that overlap a region, in ascending order; see `iter_overlaps`."""
        everything = range(len(self._base))
        return sorted(row for found in self.iter_overlaps(region, everything) for row in found)

    def iter_overlaps(self, region: Region, entities: Sequence[int]) -> Iterator[list[int]]:
        """Find which of some entities overlap a region, a few at each turn.

        Meshes count as their convex hulls, planes as nothing, and an entity without other
        collisions as the point at its root.
        """
        for group in self._layout.groups:
            near = self._find_within_reach(group, region)
            near = near[np.isin(group.rows[near], entities)]
            for at in range(0, len(near), ENTITIES_PER_TURN):
                yield from self._find_overlaps(group, near[at : at + ENTITIES_PER_TURN], region)

    def entity_overlaps(self, entity: int) -> list[int]:
        """Find the other entities that overlap an entity, in ascending order."""
        found: set[int] = set()
        for group in self._layout.groups:
            for solid, pose in self._place_members(group, np.flatnonzero(group.rows == entity)):
                for placed in map(solid.transformed_by, pose):
                    found.update(self.overlaps(make_region(placed)))
        return sorted(found - {entity})

    def nearest(self, solid: ConvexShape, ignored: Collection[int] = ()) -> tuple[float, int]:
        """Find the distance [m] of the nearest entity, and its index.

        Args:
            solid: In the world; one point for the distance of a point.
            ignored: Indices of entities that do not count.

        Returns:
            0 when it overlaps the shape; infinity and `NO_ENTITY` when there is none. Meshes count
            as their convex hulls.
        """
        shapes, best = self.shapes, (np.inf, NO_ENTITY)
        bounds = self._bound_distances(solid)
        for number in np.argsort(bounds, kind="stable").tolist():
            entity = int(shapes.entity[number])
            if bounds[number] > best[0]:
                break
            if entity not in ignored:
                best = min(best, (self._find_distance(solid, number), entity))
        return best

    def _place_members(
        self, group: ModelGroup, members: IntArray
    ) -> list[tuple[ConvexShape, FloatArray]]:
        return place_collision_shapes(
            group.model,
            self._base[group.rows[members], :7],
            self._joint_positions[group.joints[members]],
            self._layout.vertices,
        )

    def _find_within_reach(self, group: ModelGroup, region: Region) -> IntArray:
        """Find the members of a group that may overlap a region, by distance of their roots."""
        reach = find_bounding_radius(group.model, self._layout.vertices)
        roots = self._base[group.rows, :3]
        gap = np.maximum(np.maximum(region.low - roots, roots - region.high), 0.0)
        return np.flatnonzero((gap * gap).sum(axis=1) <= reach * reach)

    def _find_overlaps(
        self, group: ModelGroup, members: IntArray, region: Region
    ) -> Iterator[list[int]]:
        rows = group.rows[members]
        solids = self._place_members(group, members)
        if not solids:
            solids = [(ConvexShape(np.zeros((1, 3))), self._base[rows, :7])]
        is_in = np.zeros(len(rows), dtype=np.bool_)
        undecided: list[tuple[ConvexShape, FloatArray, BoolArray]] = []
        for solid, poses in solids:
            low, high = solid.bounds_at(poses)
            is_near = np.all((low <= region.high) & (high >= region.low), axis=1)
            is_in |= is_near & _is_within(region, low, high)
            undecided.append((solid, poses, is_near))
        yield rows[is_in].tolist()
        for at in np.flatnonzero(~is_in).tolist():
            near = [
                solid.transformed_by(poses[at])
                for solid, poses, is_near in undecided
                if is_near[at]
            ]
            if near:
                is_hit = any(are_overlapping(solid, region.shape) for solid in near)
                yield [int(rows[at])] if is_hit else []

    def _bound_distances(self, solid: ConvexShape) -> FloatArray:
        """Bound the distances (s,) [m] of a shape to all shapes from below, by spheres."""
        region = make_region(solid)
        centre, extent = (region.low + region.high) / 2.0, region.high - region.low
        centres, radii = self.shapes.bounding_spheres()
        reach = radii + float(np.linalg.norm(extent)) / 2.0
        return np.asarray(np.maximum(np.linalg.norm(centres - centre, axis=1) - reach, 0.0))

    def _find_distance(self, solid: ConvexShape, number: int) -> float:
        shapes = self.shapes
        shape = shapes.geometries[shapes.geometry[number]].shape
        pose = shapes.poses[number]
        if shape.kind == "plane":
            up = to_matrix(pose[3:])[:, 2]
            return max(float((solid.support_point(-up) - pose[:3]) @ up), 0.0)
        return find_distance(
            solid, to_convex_shape(shape, self._layout.vertices).transformed_by(pose)
        )


def _make_group(model: Model, rows: IntArray, starts: IntArray) -> ModelGroup:
    joints = starts[rows, None] + np.arange(len(model.joints))
    is_fixed = model.is_static and all(joint.kind == "fixed" for joint in model.joints)
    return ModelGroup(model, rows, joints, is_fixed)


def _make_geometry(shape: Shape, find_triangles: FindTriangles) -> ShapeGeometry:
    triangles, centre = np.zeros((0, 3, 3)), np.zeros(3)
    if shape.kind == "plane":
        return ShapeGeometry(shape, triangles, centre, np.inf)
    if shape.kind != "mesh":
        solid = to_convex_shape(shape, find_triangles)
        return ShapeGeometry(shape, triangles, centre, solid.radius_from_origin)
    corners = np.asarray(find_triangles(shape.mesh), dtype=np.float64) * np.array(shape.size)
    centre = (corners.min(axis=0) + corners.max(axis=0)) / 2.0
    radius_m = float(np.linalg.norm(corners - centre, axis=1).max())
    return ShapeGeometry(shape, corners.reshape(-1, 3, 3), centre, radius_m)


def _concatenate(parts: list[IntArray]) -> IntArray:
    return np.concatenate([np.zeros(0, np.intp), *parts])


def _is_within(region: Region, low: FloatArray, high: FloatArray) -> BoolArray:
    """Whether boxes (n, 3) are wholly inside a region; False where that takes a closer test."""
    if region.is_box:
        return np.asarray(((low >= region.low) & (high <= region.high)).all(axis=1))
    if region.shape.sphere_radius_m and len(region.shape.points) == 1:
        centre = region.shape.points[0]
        far = np.maximum(np.abs(low - centre), np.abs(high - centre))
        return np.asarray((far * far).sum(axis=1) <= region.shape.sphere_radius_m**2)
    return np.zeros(len(low), dtype=np.bool_)

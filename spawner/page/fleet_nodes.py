"""Scene nodes of the entities: a batch for each link and colour of a model."""

import itertools
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Final, Literal

import msgspec
import numpy as np
import viser
from numpy.typing import NDArray

from zensim.proto.messages.model_messages import Quat
from zensim.proto.se3 import FloatArray
from zensim.spawner.page.contact_shadows import find_ground_poses, make_shadow
from zensim.spawner.page.glb_encoding import encode_glb
from zensim.spawner.page.instance_updates import WXYZ_COLUMNS, has_moved, move_instances
from zensim.spawner.page.model_bounds import ModelBounds, make_bounds
from zensim.spawner.page.model_visuals import (
    DEFAULT_RGBA,
    ColouredMesh,
    TriangleMeshes,
    VisualTemplate,
    make_link_meshes,
)
from zensim.spawner.page.render_state import InstanceGroup, RenderedFleet, RenderedFrame
from zensim.spawner.page.robot_colours import to_linear

LOD_MIN_FACES: Final = 2000
LOD_LEVELS: Final = ((2.0, 0.4), (6.0, 0.1), (20.0, 0.02))
"""Distance [m], and share of faces that are drawn from there; for meshes above the minimum."""

BatchHandle = viser.BatchedMeshHandle | viser.BatchedGlbHandle
ClickEvent = (
    viser.SceneNodePointerEvent[viser.BatchedMeshHandle]
    | viser.SceneNodePointerEvent[viser.BatchedGlbHandle]
)
PickCallback = Callable[[int, str, bool], None]
"""Called with the client, the entity that was clicked, and whether shift was held."""


class ModelNodes:
    """Scene nodes of one template: a batch per link and colour."""

    def __init__(
        self,
        template: VisualTemplate,
        meshes: TriangleMeshes,
        scene: viser.SceneApi,
        path: str,
        *,
        has_shadow: bool = False,
    ) -> None:
        """Prepare the parts; with a shadow, each instance has a dark patch below it."""
        self.path = path
        self._scene = scene
        self._parts = [make_link_meshes(shapes, meshes) for shapes in template.links]
        self.bounds = make_bounds(template, self._parts)
        box = self.bounds.at_rest
        self._body = find_body_colour(self._parts)
        self._shadow = make_shadow(box) if has_shadow and np.any(box) else None
        if self._shadow is not None:
            self._parts.append([self._shadow])
        self._batches: list[list[BatchHandle]] = []
        self._sent: list[FloatArray] = []
        """Poses of each link that visitors have."""
        self._colours: NDArray[np.uint8] = np.zeros((0, 3), np.uint8)

    @property
    def base_path(self) -> str:
        """Path of a part of the base; empty if it has none."""
        return self._batches[0][0].name if self._batches and self._batches[0] else ""

    def show(self, links: Sequence[FloatArray], colours: NDArray[np.uint8] | None = None) -> bool:
        """Move the links that have moved visibly; return whether the nodes were created.

        Args:
            links: Poses (k, 7) of each link.
            colours: Linear colours (k, 3) of the bodies, or None for those of the model.
        """
        if self._shadow is not None:
            links = [*links, find_ground_poses(links[0])]
        if self._batches:
            if colours is not None and not np.array_equal(colours, self._colours):
                self._colours = colours
                for body in self._list_bodies():
                    body.batched_colors = colours
            for number, poses in enumerate(links):
                if has_moved(self._sent[number], poses):
                    self._sent[number] = poses
                    paths = [batch.name for batch in self._batches[number]]
                    move_instances(self._scene, paths, poses)
            return False
        self._sent = [*links]
        self._colours = colours if colours is not None else self._colours
        self._batches = [
            [self._add(f"{i}/{j}", part, poses) for j, part in enumerate(parts)]
            for i, (parts, poses) in enumerate(zip(self._parts, links, strict=True))
        ]
        return True

    def _list_bodies(self) -> Iterator[viser.BatchedMeshHandle]:
        for parts, batches in zip(self._parts, self._batches, strict=True):
            for part, batch in zip(parts, batches, strict=True):
                if self._is_body(part) and isinstance(batch, viser.BatchedMeshHandle):
                    yield batch

    def _is_body(self, part: ColouredMesh) -> bool:
        return is_paintable(part) and part.rgba == self._body

    def on_click(
        self, callback: Callable[[ClickEvent], None], *, modifier: Literal["shift"] | None = None
    ) -> None:
        """Register a callback for clicks on instances, with this key held or with none."""
        for batch in itertools.chain.from_iterable(self._batches):
            batch.on_click(modifier=modifier)(callback)

    def remove(self) -> None:
        """Remove the nodes from the scene."""
        for batch in itertools.chain.from_iterable(self._batches):
            batch.remove()

    def _add(self, place: str, part: ColouredMesh, poses: FloatArray) -> BatchHandle:
        # Levels of detail keep the largest part of a robot, which is not to be its shadow.
        root = self.path.replace("robots", "shadows") if part is self._shadow else self.path
        path = f"{root}/{place}"
        if part.mesh.image:
            return self._add_textured(path, part, poses)
        alpha = part.rgba[3]
        is_painted = len(self._colours) > 0 and self._is_body(part)
        own = to_linear(np.round(255.0 * np.array(part.rgba[:3])).astype(np.uint8))
        return self._scene.add_batched_meshes_simple(
            path,
            part.mesh.vertices,
            part.mesh.faces,
            poses[:, WXYZ_COLUMNS],
            poses[:, :3],
            batched_colors=self._colours if is_painted else own,
            opacity=alpha if alpha < 1.0 else None,
            flat_shading=not part.is_smooth,
            side="double" if part.has_file else "front",
            lod=LOD_LEVELS if len(part.mesh.faces) > LOD_MIN_FACES else "off",
            cast_shadow=part is not self._shadow,
            receive_shadow=False,  # artefacts at small faces
        )

    def _add_textured(
        self, path: str, part: ColouredMesh, poses: FloatArray
    ) -> viser.BatchedGlbHandle:
        return self._scene.add_batched_glb(
            path,
            encode_glb(part),
            poses[:, WXYZ_COLUMNS],
            poses[:, :3],
            lod="off",
            receive_shadow=False,
        )


class FleetNodes:
    """Scene nodes of all templates."""

    def __init__(self, scene: viser.SceneApi, pick: PickCallback) -> None:
        self._scene = scene
        self._pick = pick
        self._paths = (f"/robots/{number}" for number in itertools.count())
        self._nodes: dict[VisualTemplate, ModelNodes] = {}
        self._names: dict[str, tuple[str, ...]] = {}
        self._instances: dict[str, tuple[str, int]] = {}
        self._fleet: RenderedFleet | None = None

    def show(self, fleet: RenderedFleet, frame: RenderedFrame) -> None:
        """Draw all entities of a frame; nodes of deleted entities are removed."""
        for gone in self._nodes.keys() - {group.template for group in fleet.groups}:
            self._names.pop(self._nodes[gone].path, None)
            self._nodes.pop(gone).remove()
        for group, links in zip(fleet.groups, frame.links, strict=True):
            self._show_group(group, links, fleet)
        if fleet is not self._fleet:
            self._fleet = fleet
            self._instances = {
                name: (path, number)
                for group in fleet.groups
                if (path := self._nodes[group.template].base_path)
                for number, name in enumerate(group.names)
            }

    def find_bounds(self, template: VisualTemplate) -> ModelBounds:
        """Find the box around a template."""
        return self._nodes[template].bounds

    def find_instance(self, entity: str) -> tuple[str, int] | None:
        """Find the batch of a part of the base of an entity, and its number there, if any."""
        return self._instances.get(entity)

    def names_json(self) -> bytes:
        """Encode the names of instances by scene node, for `GET /names`."""
        return msgspec.json.encode(dict(self._names))

    def _show_group(
        self, group: InstanceGroup, links: Sequence[FloatArray], fleet: RenderedFleet
    ) -> None:
        nodes = self._nodes.get(group.template)
        if nodes is None:
            path, is_robot = next(self._paths), group.colours is not None
            nodes = ModelNodes(group.template, fleet.meshes, self._scene, path, has_shadow=is_robot)
            self._nodes[group.template] = nodes
        self._names[nodes.path] = group.names
        if nodes.show(links, group.colours):
            nodes.on_click(partial(self._handle_click, nodes.path))
            nodes.on_click(partial(self._handle_click, nodes.path), modifier="shift")

    def _handle_click(self, path: str, event: ClickEvent) -> None:
        names, index = self._names.get(path, ()), event.instance_index
        if index is not None and index < len(names):
            self._pick(event.client_id, names[index], event.modifier == "shift")


def is_paintable(part: ColouredMesh) -> bool:
    """Whether a part may get the colour of a robot; files and images have their own."""
    return not part.mesh.image and (not part.has_file or part.rgba == DEFAULT_RGBA)


def find_body_colour(links: Sequence[Sequence[ColouredMesh]]) -> Quat | None:
    """Find the colour of the largest part that may get the colour of a robot."""
    parts = [part for parts in links for part in parts if is_paintable(part)]
    return max(parts, key=_find_area).rgba if parts else None


def _find_area(part: ColouredMesh) -> float:
    a, b, c = (part.mesh.vertices[part.mesh.faces[:, corner]] for corner in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())

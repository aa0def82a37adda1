"""What entities are made of, drawn in the scene of a visitor: frames and collision shapes."""

from collections.abc import Sequence
from typing import Final

import msgspec
import numpy as np
import viser

from zensim.proto.messages.model_messages import Link, Model, Shape
from zensim.spawner.page.fleet_nodes import ModelNodes
from zensim.spawner.page.instance_updates import WXYZ_COLUMNS
from zensim.spawner.page.model_visuals import TriangleMeshes, VisualTemplate, make_template
from zensim.spawner.page.render_state import RenderedFleet, list_link_poses, select_instances
from zensim.spawner.page.viewer_client import PageState

AXIS_M: Final = 0.12
AXIS_RADIUS_M: Final = 0.004
MAX_FRAMES: Final = 2000
COLLISION_RGBA: Final = (1.0, 0.45, 0.1, 0.45)


class FrameAxes:
    """The axes of links: x red, y green, z blue."""

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self._node: viser.BatchedAxesHandle | None = None
        self._count = 0

    def draw(self, names: Sequence[str], state: PageState) -> None:
        """Draw the frames of all links of these entities, up to `MAX_FRAMES`."""
        poses = list_link_poses(state.fleet, state.frame, names)[:MAX_FRAMES].astype(np.float32)
        if self._node is not None and len(poses) == self._count:
            self._node.batched_positions = poses[:, :3]
            self._node.batched_wxyzs = poses[:, WXYZ_COLUMNS]
            return
        self.clear()
        self._count = len(poses)
        if len(poses):
            self._node = self._scene.add_batched_axes(
                "/frames",
                poses[:, WXYZ_COLUMNS],
                poses[:, :3],
                axes_length=AXIS_M,
                axes_radius=AXIS_RADIUS_M,
            )

    def clear(self) -> None:
        """Remove all frames."""
        if self._node is not None:
            self._node.remove()
        self._node, self._count = None, 0


class CollisionShapes:
    """The collision shapes of entities, in translucent orange."""

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self._nodes: dict[VisualTemplate, tuple[ModelNodes, int]] = {}
        self._made: tuple[RenderedFleet, dict[VisualTemplate, VisualTemplate]] | None = None
        self._added = 0

    def draw(self, names: Sequence[str], state: PageState) -> None:
        """Draw the collision shapes of these entities."""
        templates = self._find_templates(state.fleet)
        shown: set[VisualTemplate] = set()
        for template, places, links in select_instances(state.fleet, state.frame, names):
            shown.add(template)
            nodes = self._find_nodes(template, templates[template], len(places), state.fleet.meshes)
            nodes.show([pose[places] for pose in links])
        for gone in self._nodes.keys() - shown:
            self._nodes.pop(gone)[0].remove()

    def clear(self) -> None:
        """Remove all shapes."""
        for nodes, _ in self._nodes.values():
            nodes.remove()
        self._nodes, self._made = {}, None

    def _find_templates(self, fleet: RenderedFleet) -> dict[VisualTemplate, VisualTemplate]:
        if self._made is None or self._made[0] is not fleet:
            if self._made is not None:
                self.clear()
            self._made = fleet, make_collision_templates(fleet)
        return self._made[1]

    def _find_nodes(
        self, key: VisualTemplate, template: VisualTemplate, count: int, meshes: TriangleMeshes
    ) -> ModelNodes:
        found = self._nodes.get(key)
        if found is not None and found[1] == count:
            return found[0]
        if found is not None:
            found[0].remove()
        self._added += 1
        nodes = ModelNodes(template, meshes, self._scene, f"/collisions/{self._added}")
        self._nodes[key] = nodes, count
        return nodes


def make_collision_templates(fleet: RenderedFleet) -> dict[VisualTemplate, VisualTemplate]:
    """Make the templates of collision shapes, by the templates of the visuals."""
    made = {fleet.templates[name]: fleet.model_of(name) for name in reversed(fleet.names)}
    return {
        template: make_template(show_collisions(model), fleet.meshes)
        for template, model in made.items()
    }


def show_collisions(model: Model) -> Model:
    """Replace the visuals of a model by its collision shapes."""
    links = tuple(
        msgspec.structs.replace(link, visuals=_colour(link), lights=()) for link in model.links
    )
    return msgspec.structs.replace(model, links=links)


def _colour(link: Link) -> tuple[Shape, ...]:
    return tuple(
        msgspec.structs.replace(shape, rgba=COLLISION_RGBA, texture=None)
        for shape in link.collisions
    )

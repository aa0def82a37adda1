"""The fleet as viser scene nodes: one batch of meshes per link and colour, never one per robot."""

import itertools
from collections.abc import Callable, Sequence
from functools import partial
from typing import Final

import msgspec
import numpy as np
import viser

from zensim.spawner.viewer.form import Form
from zensim.spawner.viewer.kinematics import Poses
from zensim.spawner.viewer.meshes import Part, link_parts, top_of
from zensim.spawner.viewer.scene import Cohort, Fleet, Frame
from zensim.spawner.viewer.triangles import Meshes

MAX_LABELS: Final = 100
LABEL_GAP_M: Final = 0.03
MANY_FACES: Final = 2000
FROM_AFAR: Final = ((2.0, 0.4), (6.0, 0.1), (20.0, 0.02))
"""From which distance [m] what has more is drawn with which share of them."""

Click = viser.SceneNodePointerEvent[viser.BatchedMeshHandle]
Pick = Callable[[int, str], None]
"""Told the page and the entity that was clicked in it."""


class DrawnForm:
    """The scene nodes of one form: a batch per link and colour."""

    def __init__(self, form: Form, meshes: Meshes, scene: viser.SceneApi, path: str) -> None:
        self.path = path
        self.top_m = top_of(form, meshes)
        self._scene = scene
        self._parts = [link_parts(shapes, meshes) for shapes in form.links]
        self._batches: list[list[viser.BatchedMeshHandle]] = []

    def show(self, links: Sequence[Poses]) -> bool:
        """Move all instances; return whether the nodes are new."""
        if self._batches:
            for batches, poses in zip(self._batches, links, strict=True):
                for batch in batches:
                    batch.batched_positions = poses.positions.astype(np.float32)
                    batch.batched_wxyzs = poses.wxyzs.astype(np.float32)
            return False
        self._batches = [
            [self._add(f"{self.path}/{i}/{j}", part, poses) for j, part in enumerate(parts)]
            for i, (parts, poses) in enumerate(zip(self._parts, links, strict=True))
        ]
        return True

    def on_click(self, callback: Callable[[Click], None]) -> None:
        """Call back with every click on an instance."""
        for batch in itertools.chain.from_iterable(self._batches):
            batch.on_click(callback)

    def remove(self) -> None:
        """Take the nodes out of the scene."""
        for batch in itertools.chain.from_iterable(self._batches):
            batch.remove()

    def _add(self, path: str, part: Part, poses: Poses) -> viser.BatchedMeshHandle:
        red, green, blue = (round(255 * channel) for channel in part.rgba[:3])
        alpha = part.rgba[3]
        return self._scene.add_batched_meshes_simple(
            path,
            part.mesh.vertices,
            part.mesh.faces,
            poses.wxyzs,
            poses.positions,
            batched_colors=(red, green, blue),
            opacity=alpha if alpha < 1.0 else None,
            flat_shading=not part.is_smooth,
            side="double" if part.has_file else "front",
            lod=FROM_AFAR if len(part.mesh.faces) > MANY_FACES else "off",
            receive_shadow=False,  # on small faces its edges are seen
        )


class DrawnFleet:
    """All forms, and names above robots when asked for."""

    def __init__(self, scene: viser.SceneApi, pick: Pick) -> None:
        self._scene = scene
        self._pick = pick
        self._paths = (f"/robots/{number}" for number in itertools.count())
        self._forms: dict[Form, DrawnForm] = {}
        self._names: dict[str, tuple[str, ...]] = {}
        self._labels: dict[str, viser.LabelHandle] = {}

    def show(self, fleet: Fleet, frame: Frame) -> None:
        """Draw everybody where the frame says; who is gone disappears."""
        for gone in self._forms.keys() - {cohort.form for cohort in fleet.cohorts}:
            self._names.pop(self._forms[gone].path, None)
            self._forms.pop(gone).remove()
        for cohort, links in zip(fleet.cohorts, frame.links, strict=True):
            self._show_cohort(cohort, links, fleet.meshes)

    def label(self, fleet: Fleet, frame: Frame, *, is_on: bool) -> None:
        """Write names above the first `MAX_LABELS` robots, or take them away."""
        wanted = self._labelled(fleet, frame) if is_on else {}
        for name in self._labels.keys() - wanted.keys():
            self._labels.pop(name).remove()
        for name, position in wanted.items():
            if name not in self._labels:
                self._labels[name] = self._scene.add_label(
                    f"/names/{name}", name, anchor="bottom-center"
                )
            self._labels[name].position = position

    def top_m(self, form: Form) -> float:
        """How high a form stands above its base."""
        return self._forms[form].top_m

    def names_json(self) -> bytes:
        """Names of the instances by scene node, for the script that shows them."""
        return msgspec.json.encode(dict(self._names))

    def _show_cohort(self, cohort: Cohort, links: Sequence[Poses], meshes: Meshes) -> None:
        drawn = self._forms.get(cohort.form)
        if drawn is None:
            drawn = DrawnForm(cohort.form, meshes, self._scene, next(self._paths))
            self._forms[cohort.form] = drawn
        self._names[drawn.path] = cohort.names
        if drawn.show(links):
            drawn.on_click(partial(self._clicked, drawn.path))

    def _clicked(self, path: str, event: Click) -> None:
        names, index = self._names.get(path, ()), event.instance_index
        if index is not None and index < len(names):
            self._pick(event.client_id, names[index])

    def _labelled(self, fleet: Fleet, frame: Frame) -> dict[str, np.ndarray]:
        above: dict[str, np.ndarray] = {}
        for name in fleet.robots[:MAX_LABELS]:
            top = np.array((0.0, 0.0, self.top_m(fleet.forms[name]) + LABEL_GAP_M))
            above[name] = frame.base[fleet.rows[name], :3] + top
        return above

"""Outlines of the selected entities of a visitor."""

from collections.abc import Sequence
from itertools import product
from typing import Final

import numpy as np
import viser

from zensim.proto.se3 import FloatArray
from zensim.spawner.page.instance_updates import WXYZ_COLUMNS
from zensim.spawner.page.model_visuals import Array, VisualTemplate
from zensim.spawner.page.robot_colours import to_linear
from zensim.spawner.page.viewer_client import PageState, StuckNode, ViewerClient

OUTLINE_COLOURS: Final = ((255, 214, 64), (170, 178, 190))
"""Colours of the first selected entity, and of the others."""
OUTLINE_GAPS_M: Final = 0.004 * np.array([(-1.0, -1.0, 0.2), (1.0, 1.0, 1.0)])
"""Gaps between the bounds of an entity and its outline, which the ground must not hide."""
OUTLINE_PX: Final = 2.5
"""Width of its lines on the screen."""
OUTLINE_TOLERANCE_M: Final = 0.01
"""Change of the bounds of an arm that moves its outline."""
CORNER_SHARE: Final = 0.22
"""Share of each edge that is drawn at each of its ends: whole edges look larger than the entity."""


class SelectionOutlines:
    """The corners of a box around each selected entity."""

    def __init__(self, client: ViewerClient) -> None:
        self._client, self._scene = client, client.scene
        self._boxes: list[tuple[VisualTemplate, viser.LineSegmentsHandle]] = []
        self._drawn: list[Array] = []
        """Bounds (2, 3) of each box."""

    def draw(self, entities: Sequence[str], state: PageState) -> None:
        """Move the boxes to the entities that are there."""
        shown = [name for name in entities if name in state.fleet.rows]
        templates = [state.fleet.templates[name] for name in shown]
        if [template for template, _ in self._boxes] != templates:
            self._replace(shown, templates, state)
        stuck: list[StuckNode] = []
        for number, (name, (_, box)) in enumerate(zip(shown, self._boxes, strict=True)):
            bounds = state.bounds_of(name)
            if np.abs(bounds - self._drawn[number]).max() > OUTLINE_TOLERANCE_M:
                self._drawn[number] = bounds
                box.points = make_box_corners(bounds + OUTLINE_GAPS_M).astype(np.float32)
            instance = state.find_instance(name)
            if instance is not None:
                stuck.append(StuckNode(box.name, *instance, None))
                continue
            pose = state.state_of(name)
            box.position, box.wxyz = pose[:3], pose[WXYZ_COLUMNS]
        self._client.stick("outlines", tuple(stuck))

    def _replace(
        self, shown: Sequence[str], templates: Sequence[VisualTemplate], state: PageState
    ) -> None:
        for _, box in self._boxes:
            box.remove()
        self._drawn = [state.bounds_of(name) for name in shown]
        self._boxes = [
            (template, self._add(number, self._drawn[number]))
            for number, template in enumerate(templates)
        ]

    def _add(self, number: int, bounds: Array) -> viser.LineSegmentsHandle:
        return self._scene.add_line_segments(
            f"/selected/{number}",
            make_box_corners(bounds + OUTLINE_GAPS_M),
            to_linear(np.array(OUTLINE_COLOURS[min(number, 1)])),
            thickness=OUTLINE_PX,
            thickness_units="screen",
        )


def make_box_corners(bounds: Array) -> FloatArray:
    """Make the ends of edges (24, 2, 3) of a box from its lowest and highest corner (2, 3)."""
    corners = np.array([*product((0, 1), repeat=3)])
    ends, others = np.nonzero(np.abs(corners[:, None] - corners).sum(axis=2) == 1)
    places = np.where(corners == 1, bounds[1], bounds[0])
    tips = places[ends] + CORNER_SHARE * (places[others] - places[ends])
    segments: FloatArray = np.stack((places[ends], tips), axis=1)
    return segments

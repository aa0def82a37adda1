"""Scans and contacts in the scene and pictures in the panel, as a visitor has chosen."""

import time
from collections.abc import Callable, Container, Mapping
from functools import partial
from typing import Final

import numpy as np
import viser

from zensim.proto.topic_catalog import SCAN
from zensim.spawner.page.robot_colours import find_robot_colour, to_linear
from zensim.spawner.page.sensor_views import Picture, SensedFrame, SensorChoice, SensorView

SCAN_POINT_M: Final = 0.025
CLOUD_POINT_M: Final = 0.007
"""Sizes of the points of scans in a plane, and of clouds."""
HEIGHTS_M: Final = (-0.1, 0.25, 0.7, 1.5, 3.0)
HEIGHT_COLOURS: Final = (
    (72, 40, 120),
    (49, 104, 142),
    (31, 158, 137),
    (109, 205, 89),
    (240, 180, 20),
)
"""Colours of points of clouds by their height; others are between."""


class SensorDisplay:
    """Scans in the scene and pictures in the panel of one client.

    Attributes:
        chosen: What is switched on.
    """

    def __init__(self, scene: viser.SceneApi, gui: viser.GuiApi) -> None:
        self._scene, self._gui = scene, gui
        self._points: dict[SensorChoice, np.ndarray] = {}
        self._nodes: dict[str, viser.PointCloudHandle] = {}
        self._clouds: set[SensorChoice] = set()
        """Sensors whose points are not in a plane."""
        self._folder: viser.GuiFolderHandle | None = None
        self._views: dict[SensorChoice, SensorView] = {}
        self._pictures: dict[SensorChoice, viser.GuiImageHandle] = {}
        self.chosen: frozenset[SensorChoice] = frozenset()

    def open_panel(
        self,
        folder: viser.GuiFolderHandle,
        views: Mapping[SensorChoice, SensorView],
        switch: Callable[[SensorChoice, bool], None],
    ) -> None:
        """Add a switch for each sensor to the panel of a robot, in its order."""
        self._folder, self._views = folder, dict(views)
        for choice, view in views.items():
            label = f"Show {'picture' if view.is_picture else 'scan'}"
            with folder:
                box = self._gui.add_checkbox(
                    label if len(views) == 1 else f"{label} {view.topic}",
                    initial_value=choice in self.chosen,
                    hint=f"Sensor {view.title}, topic {view.topic}",
                )
            box.on_update(partial(_report_switch, switch, choice))

    def close_panel(self) -> None:
        """Switch off the pictures, which are in the panel; scans stay."""
        for choice in [one for one, view in self._views.items() if view.is_picture]:
            self.switch(choice, is_on=False)
        self._folder, self._views = None, {}

    def switch(self, choice: SensorChoice, *, is_on: bool) -> None:
        """Switch a sensor on, or off and remove what is shown of it."""
        self.chosen = self.chosen | {choice} if is_on else self.chosen - {choice}
        if is_on:
            if choice in self._views and self._views[choice].content != SCAN.name:
                self._clouds.add(choice)
            return
        if choice in self._pictures:
            self._pictures.pop(choice).remove()
        if self._points.pop(choice, None) is not None:
            self._draw_points(self._name_node(choice), choice.entity)
        self._clouds.discard(choice)

    def keep(self, sensors: Container[SensorChoice]) -> None:
        """Switch off what is not among these sensors."""
        for choice in [one for one in self.chosen if one not in sensors]:
            self.switch(choice, is_on=False)

    def show(self, sensed: SensedFrame) -> None:
        """Show what is new of the chosen sensors."""
        new = {one: points for one, points in sensed.points.items() if one in self.chosen}
        self._points |= new
        for name, entity in {(self._name_node(choice), choice.entity) for choice in new}:
            self._draw_points(name, entity)
        for choice in self.chosen & sensed.pictures.keys():
            self._show_picture(choice, sensed.pictures[choice])

    def _name_node(self, choice: SensorChoice) -> str:
        return f"/{'clouds' if choice in self._clouds else 'scans'}/{choice.entity}"

    def _draw_points(self, name: str, entity: str) -> None:
        """Draw all points of a robot that are in a node."""
        parts = [points for one, points in self._points.items() if self._name_node(one) == name]
        if not parts:
            self._nodes.pop(name).remove()
            return
        points = np.concatenate(parts).astype(np.float32)
        is_cloud = name.startswith("/clouds/")
        colours = color_heights(points) if is_cloud else np.array(find_robot_colour(entity))
        if name in self._nodes:
            self._nodes[name].points = points
            self._nodes[name].colors = colours
            return
        self._nodes[name] = self._scene.add_point_cloud(
            name,
            points,
            colours,
            point_size=CLOUD_POINT_M if is_cloud else SCAN_POINT_M,
            point_shape="circle",
            precision="float32",
            point_shading="flat",
        )

    def _show_picture(self, choice: SensorChoice, picture: Picture) -> None:
        if choice in self._pictures:
            self._pictures[choice].image = picture
        elif self._folder is not None:
            with self._folder:
                self._pictures[choice] = self._gui.add_image(
                    picture, label=choice.topic, format="jpeg"
                )


def color_heights(points: np.ndarray) -> np.ndarray:
    """Choose the colours (n, 3) of points (n, 3) by their height over the ground."""
    channels = np.array(HEIGHT_COLOURS).T
    return np.stack([np.interp(points[:, 2], HEIGHTS_M, one) for one in channels], axis=1).astype(
        np.uint8
    )


CONTACT_COLOUR: Final = (255, 64, 160)
CONTACT_POINT_M: Final = 0.03
FORCE_M_PER_N: Final = 0.01
MAX_FORCE_M: Final = 0.5
CONTACT_S: Final = 0.5
"""Contacts are removed when no message has come for this time."""


class ContactMarks:
    """Points of contact and forces in the scene of a visitor."""

    def __init__(self, scene: viser.SceneApi, clock: Callable[[], float] = time.monotonic) -> None:
        self._scene, self._clock = scene, clock
        self._nodes: list[viser.PointCloudHandle | viser.LineSegmentsHandle] = []
        self._ends_at = 0.0

    def receive(self, contacts: np.ndarray) -> None:
        """Show positions and forces (n, 2, 3) [m, N]."""
        self.clear()
        self._ends_at = self._clock() + CONTACT_S
        if not len(contacts):
            return
        points, lines = contacts[:, 0], make_force_lines(contacts)
        self._nodes = [
            self._scene.add_point_cloud(
                "/contacts/points",
                points.astype(np.float32),
                CONTACT_COLOUR,
                point_size=CONTACT_POINT_M,
                point_shape="circle",
                precision="float32",
            ),
            self._scene.add_line_segments(
                "/contacts/forces",
                lines,
                to_linear(np.array(CONTACT_COLOUR)),
                thickness=2.0,
                thickness_units="screen",
            ),
        ]

    def end_old(self) -> None:
        """Remove what has not been received for a while."""
        if self._nodes and self._clock() >= self._ends_at:
            self.clear()

    def clear(self) -> None:
        """Remove all marks."""
        for node in self._nodes:
            node.remove()
        self._nodes = []


def make_force_lines(contacts: np.ndarray) -> np.ndarray:
    """Make lines (n, 2, 3) [m] along forces from positions and forces (n, 2, 3) [m, N]."""
    ways = contacts[:, 1] * FORCE_M_PER_N
    lengths = np.linalg.norm(ways, axis=1, keepdims=True)
    ways = ways * np.minimum(1.0, MAX_FORCE_M / np.maximum(lengths, 1e-9))
    return np.stack((contacts[:, 0], contacts[:, 0] + ways), axis=1)


def _report_switch(
    switch: Callable[[SensorChoice, bool], None],
    choice: SensorChoice,
    event: viser.GuiEvent[viser.GuiCheckboxHandle],
) -> None:
    switch(choice, event.target.value)

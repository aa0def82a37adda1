"""The tab "See": what is drawn beside the entities in the scene of a visitor."""

from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Final, Literal, Protocol, get_args

import msgspec
import numpy as np
import viser

from zensim.proto.codec.message_codec import MalformedPayload
from zensim.proto.messages.sensing_messages import Contacts
from zensim.spawner.page.floor_picking import PointCallback
from zensim.spawner.page.instance_updates import MOVED, place_node
from zensim.spawner.page.label_visibility import CameraView, choose_readable
from zensim.spawner.page.motion_overlays import Trails, VelocityArrows
from zensim.spawner.page.robot_colours import find_robot_colour, to_linear
from zensim.spawner.page.sensor_display import ContactMarks
from zensim.spawner.page.sensor_views import read_contacts
from zensim.spawner.page.shape_overlays import CollisionShapes, FrameAxes
from zensim.spawner.page.side_panel import WatchedTopic
from zensim.spawner.page.viewer_client import LABEL_GAP_M, PageState, Panel, StuckNode, ViewerClient

if TYPE_CHECKING:
    from zensim.spawner.page.model_visuals import Array

MAX_NAMES: Final = 20
"""Most labelled robots, nearest to the camera; a label costs messages while its robot moves."""
MEASURE_COLOUR: Final = (255, 214, 64)
MEASURE_HEIGHT_M: Final = 0.01
"""Height above the floor."""
MEASURING: Final = "measure"
MEASURE_POINT_M: Final = 0.02
"""Radius of the first point."""
MEASURE_PX: Final = 3.0
CONTACTS_WATCH: Final = WatchedTopic("contacts")
Extent = Literal["All entities", "Selection"]


class Overlay(Protocol):
    """Something that is drawn for some entities."""

    def draw(self, names: Sequence[str], state: PageState) -> None:
        """Draw it for exactly these entities, which are all there."""

    def clear(self) -> None:
        """Remove it from the scene."""


HINTS: Final[Mapping[str, str]] = {
    "Trails": "The paths of up to 100 robots in the last 20 s.",
    "Velocity arrows": "Blue: measured; orange: commanded, of the selection. Length: the way "
    "in 1 s.",
    "Frames": "The axes of all links: x red, y green, z blue.",
    "Collision shapes": "What engines compute with, in translucent orange.",
}


class ViewPanel(Panel):
    """Controls of the tab."""

    def __init__(self, client: ViewerClient) -> None:
        """Add the controls for a visitor."""
        self._client = client
        self._labels = NameLabels(client)
        self._has_names = client.gui.add_checkbox(
            "Names",
            initial_value=True,
            hint=f"Show names of the {MAX_NAMES} nearest robots that can be read.",
        )
        self._overlays: Mapping[str, Overlay] = {
            "Trails": Trails(client.scene, find_robot_colour),
            "Velocity arrows": VelocityArrows(client.scene),
            "Frames": FrameAxes(client.scene),
            "Collision shapes": CollisionShapes(client.scene),
        }
        self._extent = client.gui.add_dropdown(
            "Draw for", get_args(Extent), hint="Entities that the following is drawn for."
        )
        self._boxes = {title: self._add_box(title) for title in self._overlays}
        self._contacts = ContactMarks(client.scene)
        self._has_contacts = client.gui.add_checkbox(
            "Contacts",
            initial_value=False,
            hint="Where robots with contact sensors touch something, and with which force.",
        )
        self._has_contacts.on_update(client.defer(self._switch_contacts))
        MeasureTool(client)  # its controls keep it

    def draw(self, state: PageState) -> None:
        """Draw what is switched on, and move the names of the selected entities."""
        self._labels.move(self._client.selected, state)
        names = self._list_shown(state)
        for title, overlay in self._overlays.items():
            if self._boxes[title].value:
                overlay.draw(names, state)

        self._contacts.end_old()

    def show_message(self, watch: WatchedTopic, message: msgspec.Struct) -> None:
        """Show contacts."""
        if watch == CONTACTS_WATCH and isinstance(message, Contacts):
            with suppress(MalformedPayload):
                self._contacts.receive(read_contacts(message))

    def update(self, state: PageState) -> None:
        """Move all names."""
        selected = [name for name in self._client.selected if name in state.fleet.rows]
        if self._has_names.value and state.fleet.robots:
            camera = self._client.client.camera
            near = find_nearest(state, np.array(camera.position), MAX_NAMES)
            names = [*dict.fromkeys([*selected, *near])]
            tops = np.array([state.find_top(name) for name in names])
            readable = choose_readable(read_camera(camera), names, tops, len(selected))
            self._labels.show(names, state, {names[number] for number in readable})
        else:
            self._labels.show(selected, state, {*selected})

    def change_selection(self) -> None:
        """Show the names of the selected entities."""
        self.update(self._client.state)

    def _add_box(self, title: str) -> viser.GuiCheckboxHandle:
        box = self._client.gui.add_checkbox(title, initial_value=False, hint=HINTS[title])
        box.on_update(self._client.defer(lambda is_on: self._switch(title, is_on)))
        return box

    def _switch_contacts(self, is_on: bool) -> None:  # noqa: FBT001
        self._client.watch("contacts", *([CONTACTS_WATCH] if is_on else []))
        self._contacts.clear()

    def _switch(self, title: str, is_on: bool) -> None:  # noqa: FBT001
        if not is_on:
            self._overlays[title].clear()

    def _list_shown(self, state: PageState) -> Sequence[str]:
        """List the entities to draw for, the selected ones first."""
        selected = self._client.selected
        if self._extent.value == "Selection" or not selected:
            return selected if self._extent.value == "Selection" else state.fleet.names
        return [*selected, *(name for name in state.fleet.names if name not in selected)]


class MeasureTool:
    """Shows the distance between two points of the floor that a visitor clicks."""

    def __init__(self, client: ViewerClient) -> None:
        self._client = client
        self._nodes: list[viser.SceneNodeHandle] = []
        self._box = client.gui.add_checkbox(
            "Measure", initial_value=False, hint="Click two points of the floor."
        )
        self._box.on_update(client.defer(self.switch))

    def switch(self, is_on: bool) -> None:  # noqa: FBT001
        """Measure from each first click to the next one, or end and remove what is drawn."""
        self._client.picker.cancel(MEASURING)
        self._clear()
        if is_on:
            self._pick(self._begin)

    def _pick(self, on_point: PointCallback) -> None:
        self._client.picker.pick(MEASURING, on_point, self._end_all)

    def _end_all(self) -> None:
        """End, as the click serves another purpose or was not on the floor."""
        self._box.value = False  # type: ignore[misc]  # the setter stands apart
        self._clear()

    def _begin(self, x: float, y: float) -> None:
        self._clear()
        at = (x, y, MEASURE_HEIGHT_M)
        self._nodes = [
            self._client.scene.add_icosphere(
                "/measure/start", MEASURE_POINT_M, MEASURE_COLOUR, position=at
            )
        ]
        self._pick(partial(self._end, at))

    def _end(self, start: tuple[float, float, float], x: float, y: float) -> None:
        end = (x, y, MEASURE_HEIGHT_M)
        text = f"{np.hypot(x - start[0], y - start[1]):.3f} m"
        self._nodes += [
            self._client.scene.add_line_segments(
                "/measure/line",
                np.array([(start, end)]),
                to_linear(np.array(MEASURE_COLOUR)),
                thickness=MEASURE_PX,
                thickness_units="screen",
            ),
            self._client.scene.add_label(
                "/measure/distance",
                text,
                position=np.mean((start, end), axis=0),
                anchor="bottom-center",
            ),
        ]
        self._pick(self._begin)

    def _clear(self) -> None:
        for node in self._nodes:
            node.remove()
        self._nodes = []


class NameLabels:
    """Names above entities."""

    def __init__(self, client: ViewerClient) -> None:
        self._client, self._scene = client, client.scene
        self._labels: dict[str, viser.LabelHandle] = {}
        self._places: dict[str, Array] = {}
        """Positions that the visitor has, by entity."""
        self._stuck: dict[str, StuckNode] = {}

    def show(self, names: Sequence[str], state: PageState, readable: Collection[str]) -> None:
        """Show the readable names of these entities, which are all there.

        The others are hidden: to remove and to add them again would take more messages.
        """
        for gone in self._labels.keys() - names:
            self._labels.pop(gone).remove()
            del self._places[gone]
        for name in names:
            is_shown = name in readable
            if name not in self._labels:
                top = self._places[name] = state.find_top(name)
                self._labels[name] = self._scene.add_label(
                    f"/names/{name}", name, anchor="bottom-center", position=top, visible=is_shown
                )
            elif self._labels[name].visible != is_shown:
                self._labels[name].visible = is_shown
        self._stuck = {}
        for name in names:
            instance, height_m = state.find_instance(name), float(state.bounds_of(name)[1, 2])
            if instance is not None:
                node = self._labels[name].name
                self._stuck[name] = StuckNode(node, *instance, height_m + LABEL_GAP_M)
        self._client.stick("names", tuple(self._stuck.values()))
        self.move(names, state)

    def move(self, names: Sequence[str], state: PageState) -> None:
        """Move shown names to their entities, if they have moved visibly."""
        moved = self._labels.keys() - self._stuck.keys()
        shown = [name for name in names if name in moved and name in state.fleet.rows]
        if not shown:
            return
        tops = np.array([state.find_top(name) for name in shown])
        before = np.array([self._places[name] for name in shown])
        for number in np.flatnonzero(np.abs(tops - before).max(axis=1) > MOVED):
            name = shown[number]
            self._places[name] = tops[number]
            place_node(self._scene, self._labels[name].name, tops[number])


def read_camera(camera: "viser.CameraHandle") -> CameraView:
    """Read the camera of a visitor."""
    pose = np.concatenate([camera.position, np.roll(camera.wxyz, -1)])
    return CameraView(pose, camera.fov, float(camera.image_height))


def find_nearest(state: PageState, position: np.ndarray, count: int) -> list[str]:
    """Find the robots nearest to a position [m]."""
    rows = [state.fleet.rows[name] for name in state.fleet.robots]
    distances = np.linalg.norm(state.frame.base[rows, :3] - position, axis=1)
    return [state.fleet.robots[i] for i in np.argsort(distances, kind="stable")[:count]]

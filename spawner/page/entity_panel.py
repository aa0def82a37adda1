"""The tab "Entities": search, list and details of entities, and how the camera follows."""

import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final, get_args

import msgspec
import viser

from zensim.proto.messages.model_messages import Model
from zensim.proto.printable_text import to_html
from zensim.spawner.page.entity_list import encode_statuses, find_statuses, list_entities
from zensim.spawner.page.page_theme import MUTED_BUTTON
from zensim.spawner.page.selection_outlines import SelectionOutlines
from zensim.spawner.page.sensor_views import SensorChoice
from zensim.spawner.page.side_panel import WatchedTopic, make_robot_html
from zensim.spawner.page.vehicle_display import VEHICLES_WATCH, VehicleDisplay
from zensim.spawner.page.viewer_client import CameraMode, PageState, Panel, ViewerClient

if TYPE_CHECKING:
    from zensim.spawner.page.render_state import RenderedFleet

LIST_PERIOD_S: Final = 0.5
"""Update period of the list."""
MAX_TREE_LINES: Final = 150
CAMERA_MODES: Final[tuple[CameraMode, ...]] = get_args(CameraMode)


class EntityPanel(Panel):
    """Controls of the tab; the script of the page fills the list and searches it."""

    def __init__(self, client: ViewerClient) -> None:
        """Add the controls for a visitor."""
        self._client = client
        self._next_list_at = 0.0
        self._listed: RenderedFleet | None = None
        self._statuses = ("", "")
        self._outlines = SelectionOutlines(client)
        client.gui.add_html(make_list_html(can_act=client.can_act))
        self._vehicles = VehicleDisplay(client.scene)
        client.find_order = self._vehicles.find_order
        self._details = EntityDetails(client, self._vehicles)

    def draw(self, state: PageState) -> None:
        """Move the outlines."""
        self._outlines.draw(self._client.selected, state)

    def update(self, state: PageState) -> None:
        """Update details, and the list from time to time."""
        self._details.update(state)
        self._vehicles.draw(self._client.selected, state)
        if time.monotonic() >= self._next_list_at:
            self._list(state)

    def change_selection(self) -> None:
        """Show details of the selection."""
        selected = self._client.selected
        self._client.watch("vehicles", *([VEHICLES_WATCH] if selected else []))
        self._vehicles.draw(selected, self._client.state)
        self._details.show()
        self._outlines.draw(self._client.selected, self._client.state)

    def show_message(self, watch: WatchedTopic, message: msgspec.Struct) -> None:
        """Take what vehicles do."""
        if watch == VEHICLES_WATCH:
            self._vehicles.receive(message)

    def _list(self, state: PageState) -> None:
        """Send what the list shows, if it has changed."""
        self._next_list_at = time.monotonic() + LIST_PERIOD_S
        if state.fleet is not self._listed:
            self._listed, self._statuses = state.fleet, ("", "")
            listed = msgspec.json.encode(list_entities(state.fleet)).decode()
            self._client.run_script(f"zensimEntities({listed})")
        statuses = find_statuses(state.fleet, state.frame, state.commands)
        encoded = encode_statuses(statuses, state.frame)
        if encoded != self._statuses:
            self._statuses = encoded
            self._client.run_script(f"zensimStatuses({', '.join(encoded)})")


def make_list_html(*, can_act: bool) -> str:
    """Make the place of the list; it says what an empty world needs.

    Args:
        can_act: Whether the visitor may spawn models.
    """
    text = "The world is empty" + (": spawn a model in the tab Edit." if can_act else ".")
    return f'<div data-zensim-part="list" data-empty="{text}"></div>'


class EntityDetails:
    """State of the first selected entity, camera, and switches of its sensors."""

    def __init__(self, client: ViewerClient, vehicles: VehicleDisplay) -> None:
        self._client, self._vehicles = client, vehicles
        self._place = client.gui.add_folder(None)
        self._folder: viser.GuiFolderHandle | None = None
        self._text: viser.GuiHtmlHandle | None = None

    def show(self) -> None:
        """Show the new selection."""
        self._client.sensors.close_panel()
        if self._folder is not None:
            self._folder.remove()
        self._folder = self._text = None
        selected = self._client.selected
        if selected:
            with self._place:
                self._folder = self._client.gui.add_folder(selected[0])
            self._add_controls(self._folder, selected)

    def update(self, state: PageState) -> None:
        """Update the text."""
        selected = self._client.selected
        if self._text is None or not selected:
            return
        name = selected[0]
        member, base = state.fleet.members[name], state.state_of(name)
        command, vehicle = state.commands.get(name), self._vehicles.find(name)
        self._text.content = make_robot_html(member, base, command, vehicle)

    def _add_controls(self, folder: viser.GuiFolderHandle, selected: Sequence[str]) -> None:
        client, fleet = self._client, self._client.state.fleet
        with folder:
            self._add_texts(selected)
        views = {one: view for one, view in fleet.sensors.items() if one.entity == selected[0]}
        with folder:
            sensors = client.gui.add_folder(None)  # pictures come below their switches
        client.sensors.open_panel(sensors, views, self._switch)
        with folder, client.gui.add_folder("Links and sensors", expand_by_default=False):
            client.gui.add_html(make_tree_html(fleet.model_of(selected[0])))

    def _add_texts(self, selected: Sequence[str]) -> None:
        client = self._client
        self._text = client.gui.add_html("")
        self.update(client.state)
        camera = client.gui.add_dropdown(
            "Camera",
            CAMERA_MODES,
            initial_value=client.camera_mode,
            hint="Orbit: turned with the mouse. Chase: from behind. Top: from above. Fixed: stays.",
        )
        camera.on_update(client.defer(self._set_camera))
        stop = client.gui.add_button("Stop following", color=MUTED_BUTTON)
        stop.on_click(client.defer(lambda _: client.select()))
        if len(selected) > 1:
            client.gui.add_html("Also selected: " + ", ".join(map(to_html, selected[1:])))

    def _set_camera(self, mode: CameraMode) -> None:
        self._client.camera_mode = mode

    def _switch(self, choice: SensorChoice, is_on: bool) -> None:  # noqa: FBT001
        self._client.post(lambda: self._client.sensors.switch(choice, is_on=is_on))


def make_tree_html(model: Model) -> str:
    """Format the tree of links of a model, with joints and sensors."""
    depths = {model.links[0].name: 0}
    for joint in model.joints:
        depths[joint.child] = depths.get(joint.parent, 0) + 1
    kinds = {joint.child: f" ({joint.kind})" for joint in model.joints}
    lines = []
    for link in model.links:
        lines.append((depths[link.name], link.name + kinds.get(link.name, "")))
        lines += [
            (depths[link.name] + 1, f"{sensor.name}: {', '.join(t.name for t in sensor.topics)}")
            for sensor in model.sensors
            if sensor.link == link.name
        ]
    if len(lines) > MAX_TREE_LINES:
        lines = [*lines[:MAX_TREE_LINES], (0, f"and {len(lines) - MAX_TREE_LINES} more")]
    rows = "".join(
        f'<div style="padding-left:{depth}em">{to_html(text)}</div>' for depth, text in lines
    )
    return f'<div style="padding:.15em .7em;font-size:.8em;overflow-x:auto">{rows}</div>'

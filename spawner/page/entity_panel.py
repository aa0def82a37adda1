"""The tab "Entities": search, list and details of entities, and how the camera follows."""

import time
from collections.abc import Sequence
from typing import Final, get_args

import viser

from zensim.proto.messages.model_messages import Model
from zensim.proto.printable_text import to_html
from zensim.spawner.page.entity_list import (
    CATEGORIES,
    CHOICES,
    Category,
    EntityStatus,
    ListedEntities,
    find_statuses,
    search_entities,
)
from zensim.spawner.page.scene_lighting import BRAND
from zensim.spawner.page.selection_outlines import SelectionOutlines
from zensim.spawner.page.sensor_views import SensorChoice
from zensim.spawner.page.side_panel import make_robot_html
from zensim.spawner.page.viewer_client import CameraMode, PageState, Panel, ViewerClient

MUTED_BUTTON: Final = (66, 71, 80)
"""Colour of buttons without effect on the simulation."""
MAX_ROWS: Final = 50
"""Entities that are listed; a search finds the others."""
LIST_PERIOD_S: Final = 0.5
"""Update period of the list."""
MAX_TREE_LINES: Final = 150
CAMERA_MODES: Final[tuple[CameraMode, ...]] = get_args(CameraMode)


class EntityPanel(Panel):
    """Controls of the tab."""

    def __init__(self, client: ViewerClient) -> None:
        """Add the controls for a visitor."""
        self._client = client
        self._next_list_at = 0.0
        self._outlines = SelectionOutlines(client.scene)
        gui = client.gui
        gui.add_button(
            "Show all", color=MUTED_BUTTON, hint="Move the camera to show all."
        ).on_click(client.defer(lambda _: client.look_at_all()))
        self._details = EntityDetails(client)
        self._text = gui.add_text("Search", "", hint="Words of names, namespaces or models.")
        self._text.on_update(client.defer(lambda _: self._list()))
        self._choice = gui.add_dropdown("Status", CHOICES)
        self._choice.on_update(client.defer(lambda _: self._list()))
        self._summary = gui.add_html("")
        self._rows = {category: EntityRows(client, category) for category in CATEGORIES}

    def draw(self, state: PageState) -> None:
        """Move the outlines."""
        self._outlines.draw(self._client.selected, state)

    def update(self, state: PageState) -> None:
        """Update details, and the list from time to time."""
        self._details.update(state)
        if time.monotonic() >= self._next_list_at:
            self._list()

    def change_selection(self) -> None:
        """Show details of the selection."""
        self._details.show()
        self._outlines.draw(self._client.selected, self._client.state)
        self._list()

    def _list(self) -> None:
        self._next_list_at = time.monotonic() + LIST_PERIOD_S
        state, text = self._client.state, self._text.value
        statuses = find_statuses(state.fleet, state.frame, state.commands)
        found = search_entities(state.fleet, statuses, text, self._choice.value)
        summary = make_summary_html(
            found.count, len(state.fleet.names), can_act=self._client.can_act
        )
        if self._summary.content != summary:
            self._summary.content = summary
        self._show_rows(found, dict(zip(state.fleet.names, statuses, strict=True)))

    def _show_rows(self, found: ListedEntities, statuses: dict[str, EntityStatus]) -> None:
        room = MAX_ROWS
        for category, names in found.names.items():
            self._rows[category].show(names[:room], len(names), statuses)
            room -= min(room, len(names))


class EntityRows:
    """A folder with a button for each listed entity of a category."""

    def __init__(self, client: ViewerClient, category: Category) -> None:
        self._client, self._category = client, category
        self._folder = client.gui.add_folder(category, visible=False)
        self._buttons: list[viser.GuiButtonHandle] = []
        self._shown: list[tuple[str, bool]] = []
        """Label of each visible button, and whether it is marked."""
        self._names: Sequence[str] = ()
        self._title: str = category

    def show(self, names: Sequence[str], total: int, statuses: dict[str, EntityStatus]) -> None:
        """Show these entities of all that were found; only what changes is sent."""
        while len(self._buttons) < len(names):
            self._add_button(len(self._buttons))
        selected = self._client.selected
        shown = [(f"{name} · {statuses[name]}", name in selected) for name in names]
        with self._client.client.atomic():
            for number, button in enumerate(self._buttons):
                self._show_row(button, number, shown)
            self._show_title(total)
        self._names, self._shown = names, shown

    def _show_title(self, total: int) -> None:
        title = f"{self._category} ({total})"
        if title != self._title:
            self._folder.label = self._title = title
        if self._folder.visible != bool(total):
            self._folder.visible = bool(total)

    def _show_row(
        self, button: viser.GuiButtonHandle, number: int, shown: Sequence[tuple[str, bool]]
    ) -> None:
        before = self._shown[number] if number < len(self._shown) else None
        after = shown[number] if number < len(shown) else None
        if after is None or before == after:
            if after is None and before is not None:
                button.visible = False
            return
        button.label, is_marked = after
        if before is None:
            button.visible = True
        if before is None or before[1] != is_marked:
            button.color = BRAND if is_marked else MUTED_BUTTON

    def _add_button(self, number: int) -> None:
        with self._folder:
            button = self._client.gui.add_button("", visible=False, color=MUTED_BUTTON)
        button.on_click(self._client.defer(lambda _: self._select(number)))
        self._buttons.append(button)

    def _select(self, number: int) -> None:
        if number < len(self._names):
            self._client.select(self._names[number])


class EntityDetails:
    """State of the first selected entity, camera, and switches of its sensors."""

    def __init__(self, client: ViewerClient) -> None:
        self._client = client
        self._place = client.gui.add_folder("Selection", visible=False)
        self._folder: viser.GuiFolderHandle | None = None
        self._text: viser.GuiHtmlHandle | None = None

    def show(self) -> None:
        """Show the new selection."""
        self._client.sensors.close_panel()
        if self._folder is not None:
            self._folder.remove()
        self._folder = self._text = None
        selected = self._client.selected
        self._place.visible = bool(selected)
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
        self._text.content = make_robot_html(member, base, state.commands.get(name))

    def _add_controls(self, folder: viser.GuiFolderHandle, selected: Sequence[str]) -> None:
        client, fleet = self._client, self._client.state.fleet
        with folder:
            self._add_texts(selected)
        views = {one: view for one, view in fleet.sensors.items() if one.entity == selected[0]}
        client.sensors.open_panel(folder, views, self._switch)
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


def make_summary_html(found: int, total: int, *, can_act: bool) -> str:
    """Say how many entities were found, and how many of them are listed.

    Args:
        found: Number.
        total: Number of all entities of the world.
        can_act: Whether the visitor may spawn some.
    """
    if not total:
        text = "The world is empty" + (": spawn a model in the tab Edit." if can_act else ".")
    elif found > MAX_ROWS:
        text = f"{found} of {total} found, the first {MAX_ROWS} listed"
    else:
        text = f"{found} of {total} found"
    return f'<div style="padding:.15em .7em;font-size:.85em;opacity:.8">{text}</div>'


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

"""The tab "Edit": spawn models, move and delete what is selected."""

import base64
import math
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from importlib.resources import files
from types import MappingProxyType
from typing import Final

import msgspec
import numpy as np
import viser

from zensim.proto.messages.entity_messages import EntityState, SetEntityStateRequest
from zensim.proto.messages.result_messages import ResultCode
from zensim.proto.messages.spawn_messages import (
    NOT_SPAWNED_PREFIX,
    DeleteEntityRequest,
    GetSpawnablesRequest,
    GetSpawnablesResponse,
    Resource,
    SpawnEntitiesOrder,
    SpawnEntitiesResponse,
    SpawnEntity,
    SpawnEntityOrder,
    SpawnEntityReport,
)
from zensim.proto.messages.standard_messages import Point, Pose, PoseStamped, Quaternion
from zensim.proto.se3 import to_yaw
from zensim.proto.service_catalog import (
    DELETE_ENTITY,
    GET_SPAWNABLES,
    SET_ENTITY_STATE,
    SPAWN_ENTITIES,
    SPAWN_ENTITY,
)
from zensim.spawner.page.page_theme import MUTED_BUTTON, STOP_BUTTON
from zensim.spawner.page.pending_deletions import UNDO_S, PendingDeletions
from zensim.spawner.page.robot_colours import Rgb
from zensim.spawner.page.shortcuts import DELETE, UNDO
from zensim.spawner.page.viewer_client import PageState, Panel, ViewerClient
from zensim.spawner.spawn.spawn_poses import LAYOUTS, FleetLayout, make_fleet_layout, make_pose

PICTURES: Final = files("zensim.spawner.page") / "pictures"
NO_MODELS: Final = "(the server lists none)"
SCHEME: Final = "zensim://"
MAX_COUNT: Final = 1000
"""Robots of one request of the page."""
MAX_POSITION_M: Final = 1e5
SPAWN_TIMEOUT_S: Final = 60.0
DELETE_TIMEOUT_S: Final = 10.0
GIZMO_SCALE_M: Final = 0.6
MOVED_M: Final = 1e-3
"""Handles follow an entity that has moved farther."""


class EditPanel(Panel):
    """Spawns, moves and deletes for one visitor."""

    def __init__(self, client: ViewerClient) -> None:
        """Add the controls, and request the models."""
        self._client = client
        self._deletions = PendingDeletions()
        self._gizmo: viser.TransformControlsHandle | None = None
        self._is_dragged = False
        self._entity = ""
        with client.gui.add_folder("Spawn"):
            self._add_spawn_form()
        with client.gui.add_folder("Selected entity"):
            self._add_selection_controls()
        client.add_command(DELETE, self.delete)
        client.add_command(UNDO, self.undo)
        self._ask_for_models()

    def _add_spawn_form(self) -> None:
        gui = self._client.gui
        self._model = gui.add_dropdown("Model", (NO_MODELS,))
        self._model.on_update(self._client.defer(self._mark_model))
        self._pictures, self._mark = gui.add_html(""), gui.add_html("")
        self._client.choose_model = self._choose_model
        self._count = gui.add_number(
            "Count", 1, min=1, max=MAX_COUNT, step=1, hint=f"1 to {MAX_COUNT}."
        )
        self._place = gui.add_vector2(
            "Place x, y [m]",
            (0.0, 0.0),
            min=(-MAX_POSITION_M,) * 2,
            max=(MAX_POSITION_M,) * 2,
            step=0.1,
        )
        self._add_button("Place by click", self.pick_place, "Then click the floor.", MUTED_BUTTON)
        self._add_button("Spawn", self.spawn, "Puts the model on the ground.")
        with gui.add_folder("Name, layout, heading", expand_by_default=False):
            self._name = gui.add_text("Name", "", hint="Empty = that of the model, with a number.")
            self._layout = gui.add_dropdown("Layout", LAYOUTS)
            self._spacing = gui.add_number("Spacing [m]", 1.0, min=0.1, max=100.0, step=0.1)
            self._heading = gui.add_number("Heading [deg]", 0.0, min=-360.0, max=360.0, step=5.0)

    def _add_selection_controls(self) -> None:
        gui = self._client.gui
        self._has_handles = gui.add_checkbox(
            "Handles", initial_value=False, hint="Drag them in the scene; it moves on release."
        )
        self._has_handles.on_update(self._client.defer(self._show_handles))
        self._target = gui.add_vector3("Move to x, y [m], heading [deg]", (0.0, 0.0, 0.0), step=0.1)
        self._add_button("Move", self.move, "To the numbers above.", MUTED_BUTTON)
        self._add_button(
            "Delete", self.delete, f"In {UNDO_S:g} s, see Undo; {DELETE.keys}", STOP_BUTTON
        )
        self._add_button(
            "Undo", self.undo, f"Keeps what is about to be deleted; {UNDO.keys}", MUTED_BUTTON
        )

    def draw(self, state: PageState) -> None:
        """Move the handles with the entity, and delete what is due."""
        for due in self._deletions.take_due(self._client.now_s()):
            self._delete(due)
        entity = self._find_entity()
        if self._gizmo is None or self._is_dragged or not entity:
            return
        base = state.state_of(entity)
        if np.linalg.norm(np.asarray(self._gizmo.position) - base[:3]) > MOVED_M:
            self._gizmo.position = base[:3]
            self._gizmo.wxyz = base[[6, 3, 4, 5]]

    def change_selection(self) -> None:
        """Put numbers and handles at the entity that is selected now."""
        entity, before = self._find_entity(), self._entity
        self._entity = entity
        if entity and entity != before:
            base = self._client.state.state_of(entity)
            heading = math.degrees(to_yaw(base[3:7]))
            self._target.value = (float(base[0]), float(base[1]), heading)  # type: ignore[misc]  # the setter stands apart
        self._show_handles(self._has_handles.value)

    def close(self) -> None:
        """Delete at once the entities that the visitor could still keep by `undo`."""
        for entity in self._deletions.take_all():
            self._delete(entity)

    def pick_place(self) -> None:
        """Take the place of the spawn form from the next click on the floor."""
        self._client.picker.pick("place", self._set_place)

    def spawn(self) -> None:
        """Spawn by the values of the form."""
        if self._model.value == NO_MODELS:
            self._ask_for_models()
            self._client.warn("the models of the server are not known yet; try again")
            return
        form = SpawnForm(
            model=self._model.value,
            name=self._name.value.strip(),
            count=round(self._count.value),
            layout=self._layout.value,
            spacing_m=float(self._spacing.value),
            place=self._place.value,
            heading_rad=math.radians(self._heading.value),
        )
        orders = make_spawn_order(form)
        if form.count > 1:
            self._client.inform(f"spawning {form.count} robots")  # a thousand take a minute
            self._client.call(SPAWN_ENTITIES, orders, self._report, SPAWN_TIMEOUT_S)
        else:
            order = select_order(orders)
            self._client.call(SPAWN_ENTITY, order, self._report_one, SPAWN_TIMEOUT_S)

    def move(self) -> None:
        """Move the selected entity to the numbers of the form."""
        entity = self._require_entity()
        if entity:
            x, y, heading = self._target.value
            height = float(self._client.state.state_of(entity)[2])
            self._move(entity, make_pose((x, y, height), (0.0, 0.0, math.radians(heading))))

    def delete(self) -> None:
        """Delete the selected entities after `UNDO_S`."""
        if not self._require_entity():
            return
        self._deletions.add(self._client.selected, self._client.now_s())
        names = ", ".join(self._client.selected)
        self._client.inform(f"{names}: deleted in {UNDO_S:g} s; Undo ({UNDO.keys}) keeps it")

    def undo(self) -> None:
        """Keep what is about to be deleted."""
        kept = self._deletions.undo()
        self._client.inform(f"{', '.join(kept)}: kept" if kept else "nothing is being deleted")

    def _delete(self, entity: str) -> None:
        request = DeleteEntityRequest(entity)
        self._client.call(DELETE_ENTITY, request, timeout_s=DELETE_TIMEOUT_S)

    def _ask_for_models(self) -> None:
        request = GetSpawnablesRequest()
        self._client.call(GET_SPAWNABLES, request, self._list_models, SPAWN_TIMEOUT_S)

    def _list_models(self, reply: GetSpawnablesResponse) -> None:
        names = [one.entity_resource.uri.removeprefix(SCHEME) for one in reply.spawnables]
        if names:
            self._model.options = tuple(names)
            self._pictures.content = make_pictures_html(names)
            self._mark_model(self._model.value)

    def _choose_model(self, model: str) -> None:
        if model in self._model.options:
            self._model.value = model  # type: ignore[misc]  # the setter stands apart
            self._mark_model(model)

    def _mark_model(self, model: str) -> None:
        self._mark.content = make_mark_html(model)

    def _set_place(self, x: float, y: float) -> None:
        self._place.value = (round(x, 3), round(y, 3))  # type: ignore[misc]

    def _report_one(self, reply: SpawnEntityReport) -> None:
        self._client.inform(f"spawned {reply.entity_name}")
        for entry in reply.report:
            if entry.status == "suspicious":
                self._client.warn(f"{reply.entity_name}: {entry.subject}: {entry.reason}")

    def _report(self, reply: SpawnEntitiesResponse) -> None:
        names = [one.entity_name for one in reply.results if one.result.result == ResultCode.OK]
        reasons = [one.result.error_message for one in reply.results if one.result.error_message]
        own = [reason for reason in reasons if not reason.startswith(NOT_SPAWNED_PREFIX)]
        if names:
            more = f" and {len(names) - 1} more" if len(names) > 1 else ""
            self._client.inform(f"spawned {names[0]}{more}")
        if reasons:
            self._client.warn(f"{len(reasons)} not spawned: {(own or reasons)[0]}")

    def _find_entity(self) -> str:
        known = self._client.state.fleet.rows
        return next((name for name in self._client.selected if name in known), "")

    def _require_entity(self) -> str:
        entity = self._find_entity()
        if not entity:
            self._client.warn("no entity is selected; click one, or a row of Entities")
        return entity

    def _move(self, entity: str, pose: Pose) -> None:
        request = SetEntityStateRequest(
            entity, EntityState(pose=pose), set_pose=True, set_twist=True
        )
        self._client.call(SET_ENTITY_STATE, request)

    def _show_handles(self, is_on: bool) -> None:  # noqa: FBT001  value of a checkbox
        entity = self._find_entity() if is_on else ""
        if self._gizmo is not None:
            self._gizmo.remove()
            self._gizmo, self._is_dragged = None, False
        if not entity:
            return
        base = self._client.state.state_of(entity)
        self._gizmo = self._client.scene.add_transform_controls(
            "/handles",
            scale=GIZMO_SCALE_M,
            depth_test=False,
            position=base[:3],
            wxyz=base[[6, 3, 4, 5]],
        )
        self._gizmo.on_update(lambda event: self._handle_drag(entity, event))

    def _handle_drag(self, entity: str, event: viser.TransformControlsEvent) -> None:
        if event.phase == "update":
            return
        w, x, y, z = (float(one) for one in event.target.wxyz)
        position = Point(*(float(one) for one in event.target.position))
        pose = Pose(position, Quaternion(x, y, z, w))
        is_over = event.phase == "end"
        self._client.post(lambda: self._end_drag(entity, pose) if is_over else self._begin_drag())

    def _begin_drag(self) -> None:
        self._is_dragged = True

    def _end_drag(self, entity: str, pose: Pose) -> None:
        self._is_dragged = False
        self._move(entity, pose)

    def _add_button(
        self, label: str, act: Callable[[], None], hint: str, colour: Rgb | None = None
    ) -> None:
        button = self._client.gui.add_button(label, hint=hint, color=colour)
        button.on_click(lambda _: self._client.post(act))


@cache
def list_pictures() -> Mapping[str, str]:
    """List the pictures of models that the package has, as addresses with their data, by model."""
    found = {
        one.name.removesuffix(".png"): base64.b64encode(one.read_bytes()).decode()
        for one in PICTURES.iterdir()
        if one.name.endswith(".png")
    }
    return MappingProxyType({m: f"data:image/png;base64,{data}" for m, data in found.items()})


def make_pictures_html(models: Sequence[str]) -> str:
    """Make a button for each of these models that has a picture in the package.

    The script of the page sends a `ZensimModel` when it is pressed.
    """
    pictures = list_pictures()
    buttons = "".join(
        f'<button type="button" data-zensim-model="{model}" aria-label="{model}">'
        f'<img alt="" src="{pictures[model]}"><span>{model.replace("_", "_<wbr>")}</span></button>'
        for model in models
        if model in pictures
    )
    return f'<div class="zensim-models" role="group" aria-label="Models">{buttons}</div>'


def make_mark_html(model: str) -> str:
    """Mark the picture of a model as the chosen one, without sending the pictures again."""
    if model not in list_pictures():
        return ""
    return (
        f'<style>[data-zensim-model="{model}"] {{ border-color: currentColor !important; }}</style>'
    )


class SpawnForm(msgspec.Struct, frozen=True, kw_only=True):
    """Values of the form that spawns."""

    model: str
    """Name of a model of the server."""
    name: str = ""
    """Name of one, or start of the names of several; empty = that of the model, with a number."""
    count: int = 1
    layout: FleetLayout = "row"
    spacing_m: float = 1.0
    place: tuple[float, float] = (0.0, 0.0)
    """Origin of the layout [m]."""
    heading_rad: float = 0.0
    """Angle by which the layout and its robots are turned."""


def make_spawn_order(form: SpawnForm) -> SpawnEntitiesOrder:
    """Make the order of a number of equal models on the ground, all or none of them."""
    cosine, sine = math.cos(form.heading_rad), math.sin(form.heading_rad)
    orders = []
    for one in make_fleet_layout(form.name, form.count, form.layout, form.spacing_m):
        x = form.place[0] + cosine * one.x - sine * one.y
        y = form.place[1] + sine * one.x + cosine * one.y
        pose = make_pose((x, y, 0.0), (0.0, 0.0, form.heading_rad + one.yaw))
        own_name = one.name if form.count > 1 and form.name else form.name
        orders.append(
            SpawnEntity(own_name, allow_renaming=not form.name, initial_pose=PoseStamped(pose=pose))
        )
    resource = Resource(uri=SCHEME + form.model)
    common = SpawnEntityOrder(entity_resource=resource, snap_to_ground=True)
    return SpawnEntitiesOrder(tuple(orders), atomic=True, common=common)


def select_order(orders: SpawnEntitiesOrder) -> SpawnEntityOrder:
    """Make the order of the only entity of some orders: its reply has the report."""
    (one,) = orders.spawn_requests
    return msgspec.structs.replace(
        orders.common,
        name=one.name,
        allow_renaming=one.allow_renaming,
        initial_pose=one.initial_pose,
    )

"""A visitor of the page: camera, selection and the panels of its tabs."""

import json
import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, Final, Literal

import msgspec
import numpy as np
import viser

from zensim.proto.se3 import FloatArray, to_yaw, transform_points
from zensim.proto.service_catalog import Service
from zensim.spawner.page.floor_picking import Act, FloorPicker
from zensim.spawner.page.model_bounds import ModelBounds
from zensim.spawner.page.model_visuals import Array, VisualTemplate
from zensim.spawner.page.page_server import run_script
from zensim.spawner.page.render_state import (
    LastCommand,
    RenderedFleet,
    RenderedFrame,
    SimulationStatus,
    View,
    choose_view,
    fit_camera,
    list_link_poses,
)
from zensim.spawner.page.scene_lighting import FOV_RAD, START_CAMERA, Scenery
from zensim.spawner.page.sensor_display import SensorDisplay
from zensim.spawner.page.shortcuts import PageCommand
from zensim.spawner.page.side_panel import WatchedTopic, WorldCall, ignore

if TYPE_CHECKING:
    from zensim.spawner.page.script_messages import ScriptMessage

CameraMode = Literal["Orbit", "Chase", "Top", "Fixed"]
FOLLOW_GAIN: Final = 0.2
"""Share of the distance to the followed entity that the camera moves per call."""
FOLLOW_DISTANCE_M: Final = 1.6
"""Distance of the camera from the followed entity."""
FOLLOW_RADII: Final = 3.0
"""The same for large entities, in radii of their bounds."""
NEAR_SHARE: Final = 0.8
"""Share of that distance that a selection brings the camera to at least."""
ARRIVED_SHARE: Final = 0.98
CHASE_OFFSET_M: Final = (-1.3, 0.0, 0.7)
"""Offset of a chasing camera in the frame of the base, turned by its yaw only."""
TOP_HEIGHT_M: Final = 3.0
TOP_SLANT_M: Final = 0.01
"""Keeps a camera that looks down from the pole of its orbit, where yaw is undefined."""
CAMERA_TOLERANCE: Final = 0.01
"""Deviation [m or rad] below which a camera counts as not moved."""
MAX_SELECTED: Final = 8
"""Entities that a visitor may select: each has an outline and subscriptions."""
LABEL_GAP_M: Final = 0.03
WARNING_S: Final = 6.0
"""Time for which a notification is shown."""


class PageState(msgspec.Struct, frozen=True, eq=False):
    """What panels show."""

    fleet: RenderedFleet = RenderedFleet()
    frame: RenderedFrame = RenderedFrame()
    status: SimulationStatus = SimulationStatus()
    commands: Mapping[str, LastCommand] = {}
    """Last velocity command of the selected entities."""
    find_bounds: Callable[[VisualTemplate], ModelBounds] = lambda _: ModelBounds(np.zeros((2, 3)))
    """Finds the box around a template."""
    find_instance: Callable[[str], tuple[str, int] | None] = lambda _: None
    """Finds the batch, and the number in it, of a part of the base of an entity."""

    def state_of(self, entity: str) -> Array:
        """Return the state (STATE_COLUMNS,) of an entity."""
        state: Array = self.frame.base[self.fleet.rows[entity]]
        return state

    def bounds_of(self, entity: str) -> Array:
        """Return the lowest and highest corner (2, 3) of an entity in the frame of its base."""
        bounds = self.find_bounds(self.fleet.templates[entity])
        return bounds.find(lambda: list_link_poses(self.fleet, self.frame, (entity,)))

    def find_middle(self, entity: str) -> Array:
        """Find the middle of the bounds of an entity in the world."""
        return transform_points(self.state_of(entity)[:7], self.bounds_of(entity).mean(axis=0))

    def find_follow_distance(self, entity: str) -> float:
        """Find the distance [m] at which a camera that follows an entity has all of it in view."""
        radius = float(np.linalg.norm(np.ptp(self.bounds_of(entity), axis=0))) / 2.0
        return max(FOLLOW_DISTANCE_M, FOLLOW_RADII * radius)

    def find_top(self, entity: str) -> Array:
        """Find the position above an entity where its name is shown."""
        height_m = self.bounds_of(entity)[1, 2] + LABEL_GAP_M
        top: Array = self.state_of(entity)[:3] + np.array((0.0, 0.0, height_m))
        return top


class StuckNode(msgspec.Struct, frozen=True, array_like=True):
    """A node of a visitor that is where an entity is."""

    node: str
    batch: str
    """Node of a part of the base of the entity."""
    number: int
    """Place of the entity in the batch."""
    lift_m: float | None
    """Height above the entity of a node that stands upright; None = it turns along."""


class Panel:
    """The controls in one tab of one visitor; the thread that draws calls its methods."""

    def draw(self, state: PageState) -> None:
        """Draw a frame, up to 40 times a second; for what moves with the entities."""

    def update(self, state: PageState) -> None:
        """Update texts and lists, 7 times a second."""

    def change_selection(self) -> None:
        """Adapt to the new `ViewerClient.selected`."""

    def close(self) -> None:
        """End what the visitor has begun, after it has left."""

    def show_message(self, watch: WatchedTopic, message: msgspec.Struct) -> None:
        """Take a new message of a topic that a panel of the visitor watches."""


PanelFactory = Callable[["ViewerClient"], Panel]
"""Makes the controls of a tab within its container."""


class ViewerClient:
    """A visitor: what it selects, how its camera follows, and its panels.

    Attributes:
        client: Handle of viser.
        gui: Controls of this visitor.
        scene: Scene nodes of this visitor.
        selected: Names of the selected entities, in the order of selection.
        camera_mode: How the camera follows the first selected entity.
        sensors: Its scans and pictures.
        scenery: Its ground and background.
        picker: Takes clicks on the floor, for one panel at a time.
        state: What is drawn.
        now_s: Reads the monotonic time [s].
        can_act: Whether it may change the world.
        find_order: Finds the order of a vehicle of a fleet manager; empty if there is none.
        receive: Called with each message of the page's script, by the thread that receives.
        choose_model: Called with the model whose picture the visitor has pressed.
        notify: Notifies another visitor.
    """

    camera_mode: CameraMode = "Orbit"

    def __init__(
        self,
        client: viser.ClientHandle,
        post: Callable[[Act], None],
        call: Callable[[WorldCall], None],
        clock: Callable[[], float] = time.monotonic,
        *,
        can_act: bool = False,
    ) -> None:
        """Make a visitor.

        Args:
            client: Handle of viser.
            post: Queues a function for the thread that draws; ignored once the visitor has left.
            call: Queues a call of a service.
            clock: Reads the monotonic time [s].
            can_act: Whether it may change the world.
        """
        self.now_s, self.can_act = clock, can_act
        self.client, self.gui, self.scene = client, client.gui, client.scene
        self.post, self._call = post, call
        self.sensors = SensorDisplay(client.scene, client.gui)
        self.scenery = Scenery(client)
        self.picker = FloorPicker(client.scene, post, self.warn, self._show_picking)
        self.selected: tuple[str, ...] = ()
        self.state = PageState()
        self.find_order: Callable[[str], str] = lambda _: ""
        self.receive: Callable[[ScriptMessage], None] = ignore
        self.choose_model: Callable[[str], None] = ignore
        self.notify: Callable[[int, str], None] = lambda _visitor, _text: None
        self._panels: list[Panel] = []
        self._watches: dict[str, frozenset[WatchedTopic]] = {}
        self._stuck: dict[str, tuple[StuckNode, ...]] = {}
        self._focus = np.zeros(3)
        self._moves_back = False
        """Whether the camera is too near to what was selected, and moves back."""
        self._names: tuple[str, ...] = ()
        self._camera_at = np.array(START_CAMERA[0])
        self._shown: tuple[tuple[str, ...], int, float] = ((), 0, 0.0)
        self.scenery.keep(None)

    def add_tabs(self, factories: Mapping[str, PanelFactory]) -> None:
        """Add the panels, one in each tab of a group."""
        group = self.gui.add_tab_group()
        for title, factory in factories.items():
            with group.add_tab(title):
                self._panels.append(factory(self))

    def defer(self, act: Callable[[Any], None]) -> Callable[[viser.GuiEvent[Any]], None]:
        """Make a callback of a control: `act` gets its value in the thread that draws.

        A value that the program sets itself is no input of the visitor, and is ignored.
        """

        def take(event: viser.GuiEvent[Any]) -> None:
            if event.client_id is not None:
                self.post(partial(act, event.target.value))

        return take

    def call(
        self,
        service: Service[Any, Any],
        request: msgspec.Struct,
        on_reply: Callable[[Any], None] = ignore,
        timeout_s: float = 0.0,
        on_error: Callable[[str], None] = ignore,
    ) -> None:
        """Call a service of the world; the visitor is notified of a refusal.

        Args:
            service: From the catalog.
            request: Of this service.
            on_reply: Called with the response in the thread that draws.
            timeout_s: Time limit of a long call, made on a thread of its own; 0 = a short call.
            on_error: Called with the reason of a refusal, before the visitor is notified.
        """

        def fail(reason: str) -> None:
            on_error(reason)
            self.warn(reason)

        self._call(WorldCall(service, request, on_reply, fail, timeout_s))

    def _show_picking(self, purpose: str) -> None:
        self.run_script(f"zensimPicks({json.dumps(purpose)})")

    def add_command(self, command: PageCommand, act: Act) -> None:
        """Add a command to the palette, with its key."""
        handle = self.gui.add_command(command.label, hotkey=command.key, modifier=command.modifier)
        handle.on_trigger(lambda _: self.post(act))

    def close(self) -> None:
        """End what the visitor has begun, after it has left."""
        for panel in self._panels:
            panel.close()

    @property
    def watched(self) -> frozenset[WatchedTopic]:
        """Topics that any panel watches."""
        return frozenset[WatchedTopic]().union(*self._watches.values())

    def watch(self, purpose: str, *watches: WatchedTopic) -> None:
        """Watch exactly these topics for a purpose."""
        self._watches[purpose] = frozenset(watches)

    def stick(self, purpose: str, nodes: tuple[StuckNode, ...]) -> None:
        """Let exactly these nodes stick to entities for a purpose.

        The browser moves them, as it draws what moves later than it receives it.
        """
        if self._stuck.get(purpose, ()) == nodes:
            return
        self._stuck[purpose] = nodes
        everything = [one for some in self._stuck.values() for one in some]
        self.run_script(f"zensimStick({msgspec.json.encode(everything).decode()})")

    def show_messages(self, messages: Mapping[WatchedTopic, msgspec.Struct]) -> None:
        """Hand new messages to the panels."""
        for watch in self.watched & messages.keys():
            for panel in self._panels:
                panel.show_message(watch, messages[watch])

    def select(self, *entities: str) -> None:
        """Select these entities, the first of which the camera follows; none = stop following."""
        known = [name for name in dict.fromkeys(entities) if name in self.state.fleet.rows]
        self._moves_back = known[:1] != [*self.selected[:1]]
        self.selected = tuple(known[:MAX_SELECTED])
        self._focus = np.array(self.client.camera.look_at)
        self.run_script(f"zensimSelected({json.dumps(self.selected)})")
        for panel in self._panels:
            panel.change_selection()

    def toggle(self, entity: str) -> None:
        """Add an entity to the selection, or remove it."""
        others = [name for name in self.selected if name != entity]
        self.select(*others, *([] if entity in self.selected else [entity]))

    def draw(self, state: PageState) -> None:
        """Draw one snapshot."""
        self.state = state
        if not self.selected:
            self._frame_all_if_changed()
        gone = [name for name in self.selected if name not in state.fleet.rows]
        if gone:
            self.select(*(name for name in self.selected if name not in gone))
        self.sensors.keep(state.fleet.sensors)
        self.scenery.keep(state.fleet.scene.background)
        with self.client.atomic():
            for panel in self._panels:
                panel.draw(state)

    def update(self) -> None:
        """Update the texts of the panels."""
        with self.client.atomic():
            for panel in self._panels:
                panel.update(self.state)

    def look_at_all(self) -> None:
        """Select nothing, and move the camera so that all entities are in view."""
        self.select()
        if self.state.fleet.names:
            self._show(choose_view(self.state.fleet, self.state.frame, self.state.find_bounds))

    def look_at(self, position: FloatArray, target: FloatArray) -> None:
        """Place the camera [m]."""
        with self.client.atomic():
            self.client.camera.position = position
            self.client.camera.look_at = target

    def move(self) -> None:
        """Move the camera towards the followed entity; call periodically."""
        if self.camera_mode == "Fixed" or not self.selected:
            return
        if self.selected[0] not in self.state.fleet.rows:
            return
        entity = self.selected[0]
        self._focus = self._focus + (self.state.find_middle(entity) - self._focus) * FOLLOW_GAIN
        camera = self.client.camera
        position, target = np.array(camera.position), np.array(camera.look_at)
        reach_m = self.state.find_follow_distance(entity)
        follow = CameraFollow(
            self.camera_mode,
            float(to_yaw(self.state.state_of(entity)[3:7])),
            NEAR_SHARE * reach_m if self._moves_back else 0.0,
            reach_m,
        )
        place = place_camera(follow, position, target, self._focus)
        distance_m = float(np.linalg.norm(place - self._focus))
        self._moves_back = self._moves_back and distance_m < ARRIVED_SHARE * follow.least_m
        self.look_at(place, self._focus)

    def run_script(self, source: str) -> None:
        """Run a script in the browser."""
        run_script(self.client, source)

    def begin(self, *, is_grey: bool) -> None:
        """Let the browser forget the selection of an earlier visit, if it has reconnected."""
        self.run_script("zensimSelected([]); zensimDrives(false)")
        self.grey(is_grey=is_grey)

    def grey(self, *, is_grey: bool) -> None:
        """Show the scene without colours, or with them."""
        self.run_script(f"zensimGreys({json.dumps(is_grey)})")

    def inform(self, text: str) -> None:
        """Show a notification of what was done."""
        self.client.add_notification("zensim", text, color="blue", auto_close_seconds=WARNING_S)

    def warn(self, text: str) -> None:
        """Show a notification of what was refused, or failed."""
        self.client.add_notification("zensim", text, color="orange", auto_close_seconds=WARNING_S)

    def _frame_all_if_changed(self) -> None:
        """Show all of another world, and of another image unless the user moved the camera."""
        fleet = self.state.fleet
        if not fleet.names:
            return
        before, self._names = self._names, fleet.names
        is_other_world = (
            bool(before) and before is not fleet.names and not {*before} & {*fleet.names}
        )
        if is_other_world or (self._find_framed() != self._shown and self._is_untouched()):
            self._show(choose_view(fleet, self.state.frame, self.state.find_bounds))

    def _show(self, view: View) -> None:
        camera = self.client.camera
        position, target = fit_camera(view, aspect=camera.aspect, fov_rad=camera.fov)
        self.look_at(position, target)
        self._camera_at, self._shown = position, self._find_framed()

    def _find_framed(self) -> tuple[tuple[str, ...], int, float]:
        """What a view depends on: the panel takes a part of the image after it was opened."""
        fleet = self.state.fleet
        return fleet.names, len(fleet.meshes), round(self.client.camera.aspect, 2)

    def _is_untouched(self) -> bool:
        """Whether the camera is where the page put it; that of a new client is invalid at first."""
        camera = self.client.camera
        has_fov = abs(camera.fov - FOV_RAD) < CAMERA_TOLERANCE
        return has_fov and np.allclose(
            camera.position, self._camera_at, rtol=0.0, atol=CAMERA_TOLERANCE
        )


class CameraFollow(msgspec.Struct, frozen=True):
    """How a camera follows an entity."""

    mode: CameraMode
    yaw_rad: float
    """Heading of the entity."""
    least_m: float
    """Distance below which it moves back."""
    reach_m: float
    """Distance beyond which it comes nearer."""


def place_camera(follow: CameraFollow, position: Array, target: Array, focus: Array) -> Array:
    """Find the next position of a camera that follows a point.

    Args:
        follow: How it follows.
        position: Of the camera now.
        target: That the camera looks at now.
        focus: That it shall look at.
    """
    offset = position - target
    if follow.mode == "Orbit":
        distance = max(float(np.linalg.norm(offset)), 1e-6)
        wanted_m = min(max(distance, follow.least_m), follow.reach_m)
        return focus + offset * (1.0 + (wanted_m / distance - 1.0) * FOLLOW_GAIN)
    scale = follow.reach_m / FOLLOW_DISTANCE_M
    wanted = scale * _find_offset(follow.mode, follow.yaw_rad)
    return focus + offset + (wanted - offset) * FOLLOW_GAIN


def _find_offset(mode: CameraMode, yaw_rad: float) -> Array:
    if mode == "Top":
        return np.array((-TOP_SLANT_M, 0.0, TOP_HEIGHT_M))
    x, y, z = CHASE_OFFSET_M
    cosine, sine = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.array((x * cosine - y * sine, x * sine + y * cosine, z))

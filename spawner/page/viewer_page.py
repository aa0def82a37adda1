"""The page with viser's handles: batched scene nodes, the shared panel, and each connected client's camera."""

import itertools
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from queue import Empty, SimpleQueue
from typing import Final, cast

import msgspec
import numpy as np
import viser

from zensim.proto.messages.telemetry_messages import EntityModel
from zensim.proto.messages.world_messages import Scene
from zensim.proto.se3 import FloatArray
from zensim.spawner.page import scene_setup
from zensim.spawner.page.http_server import close_server, open_server
from zensim.spawner.page.model_visuals import (
    Array,
    ColouredMesh,
    TriangleMeshes,
    VisualTemplate,
    find_top,
    make_link_meshes,
)
from zensim.spawner.page.render_state import (
    InstanceGroup,
    LastCommand,
    RenderedFleet,
    RenderedFrame,
    SimulationStatus,
    fit_camera,
)
from zensim.spawner.page.scene_setup import FOV_RAD, MUTED_BUTTON, START_CAMERA, SceneLighting
from zensim.spawner.page.side_panel import BUTTONS, Button, make_robot_html, make_status_html

WXYZ_COLUMNS: Final = [6, 3, 4, 5]
"""Of a pose: viser's order of a quaternion."""
MAX_LABELS: Final = 100
LABEL_GAP_M: Final = 0.03
LOD_MIN_FACES: Final = 2000
LOD_LEVELS: Final = ((2.0, 0.4), (6.0, 0.1), (20.0, 0.02))
"""From which distance [m] what has more is drawn with which share of them."""

ClickEvent = viser.SceneNodePointerEvent[viser.BatchedMeshHandle]
PickCallback = Callable[[int, str], None]
"""Told the page and the entity that was clicked in it."""


class ModelNodes:
    """The scene nodes of one form: a batch per link and colour."""

    def __init__(
        self, form: VisualTemplate, meshes: TriangleMeshes, scene: viser.SceneApi, path: str
    ) -> None:
        self.path = path
        self.top_m = find_top(form, meshes)
        self._scene = scene
        self._parts = [make_link_meshes(shapes, meshes) for shapes in form.links]
        self._batches: list[list[viser.BatchedMeshHandle]] = []

    def show(self, links: Sequence[FloatArray]) -> bool:
        """Move all instances; return whether the nodes are new."""
        if self._batches:
            for batches, poses in zip(self._batches, links, strict=True):
                for batch in batches:
                    batch.batched_positions = poses[:, :3].astype(np.float32)
                    batch.batched_wxyzs = poses[:, WXYZ_COLUMNS].astype(np.float32)
            return False
        self._batches = [
            [self._add(f"{self.path}/{i}/{j}", part, poses) for j, part in enumerate(parts)]
            for i, (parts, poses) in enumerate(zip(self._parts, links, strict=True))
        ]
        return True

    def on_click(self, callback: Callable[[ClickEvent], None]) -> None:
        """Call back with every click on an instance."""
        for batch in itertools.chain.from_iterable(self._batches):
            batch.on_click(callback)

    def remove(self) -> None:
        """Take the nodes out of the scene."""
        for batch in itertools.chain.from_iterable(self._batches):
            batch.remove()

    def _add(self, path: str, part: ColouredMesh, poses: FloatArray) -> viser.BatchedMeshHandle:
        red, green, blue = (round(255 * channel) for channel in part.rgba[:3])
        alpha = part.rgba[3]
        return self._scene.add_batched_meshes_simple(
            path,
            part.mesh.vertices,
            part.mesh.faces,
            poses[:, WXYZ_COLUMNS],
            poses[:, :3],
            batched_colors=(red, green, blue),
            opacity=alpha if alpha < 1.0 else None,
            flat_shading=not part.is_smooth,
            side="double" if part.has_file else "front",
            lod=LOD_LEVELS if len(part.mesh.faces) > LOD_MIN_FACES else "off",
            receive_shadow=False,  # on small faces its edges are seen
        )


class FleetNodes:
    """All forms, and names above robots when asked for."""

    def __init__(self, scene: viser.SceneApi, pick: PickCallback) -> None:
        self._scene = scene
        self._pick = pick
        self._paths = (f"/robots/{number}" for number in itertools.count())
        self._forms: dict[VisualTemplate, ModelNodes] = {}
        self._names: dict[str, tuple[str, ...]] = {}
        self._labels: dict[str, viser.LabelHandle] = {}

    def show(self, fleet: RenderedFleet, frame: RenderedFrame) -> None:
        """Draw everybody where the frame says; who is gone disappears."""
        for gone in self._forms.keys() - {cohort.form for cohort in fleet.groups}:
            self._names.pop(self._forms[gone].path, None)
            self._forms.pop(gone).remove()
        for cohort, links in zip(fleet.groups, frame.links, strict=True):
            self._show_group(cohort, links, fleet.meshes)

    def label(self, fleet: RenderedFleet, frame: RenderedFrame, *, is_on: bool) -> None:
        """Write names above the first `MAX_LABELS` robots, or take them away."""
        wanted = self._find_label_positions(fleet, frame) if is_on else {}
        for name in self._labels.keys() - wanted.keys():
            self._labels.pop(name).remove()
        for name, position in wanted.items():
            if name not in self._labels:
                self._labels[name] = self._scene.add_label(
                    f"/names/{name}", name, anchor="bottom-center"
                )
            self._labels[name].position = position

    def top_m(self, form: VisualTemplate) -> float:
        """How high a form stands above its base."""
        return self._forms[form].top_m

    def names_json(self) -> bytes:
        """Names of the instances by scene node, for the script that shows them."""
        return msgspec.json.encode(dict(self._names))

    def _show_group(
        self, cohort: InstanceGroup, links: Sequence[FloatArray], meshes: TriangleMeshes
    ) -> None:
        drawn = self._forms.get(cohort.form)
        if drawn is None:
            drawn = ModelNodes(cohort.form, meshes, self._scene, next(self._paths))
            self._forms[cohort.form] = drawn
        self._names[drawn.path] = cohort.names
        if drawn.show(links):
            drawn.on_click(partial(self._handle_click, drawn.path))

    def _handle_click(self, path: str, event: ClickEvent) -> None:
        names, index = self._names.get(path, ()), event.instance_index
        if index is not None and index < len(names):
            self._pick(event.client_id, names[index])

    def _find_label_positions(
        self, fleet: RenderedFleet, frame: RenderedFrame
    ) -> dict[str, np.ndarray]:
        above: dict[str, np.ndarray] = {}
        for name in fleet.robots[:MAX_LABELS]:
            top = np.array((0.0, 0.0, self.top_m(fleet.forms[name]) + LABEL_GAP_M))
            above[name] = frame.base[fleet.rows[name], :3] + top
        return above


FOLLOW_GAIN: Final = 0.2
"""Share of the way that the camera goes towards the followed robot at each call."""
FOLLOW_DISTANCE_M: Final = 1.6
"""A camera that is farther away comes this close."""
CAMERA_TOLERANCE: Final = 0.01
"""Metres or radians by which a camera may be off and yet be where it was put."""


class ViewerClient:
    """A page that somebody has open."""

    def __init__(self, client: viser.ClientHandle, release: Callable[[], None]) -> None:
        self._client = client
        self._release = release
        self._folder: viser.GuiFolderHandle | None = None
        self._text: viser.GuiHtmlHandle | None = None
        self._label: viser.LabelHandle | None = None
        self._focus = np.zeros(3)
        self._left_at = np.array(START_CAMERA[0])
        self._shown: tuple[str, ...] = ()
        self.follows = ""

    def frame_all_if_changed(self, names: tuple[str, ...], points: Array) -> None:
        """Show everybody whenever somebody comes or goes, until the visitor moves the camera."""
        if names and names != self._shown and not self.follows and self._is_untouched():
            self.look_at_all(names, points)

    def look_at_all(self, names: tuple[str, ...], points: Array) -> None:
        """Point the camera so that everybody is in view."""
        camera = self._client.camera
        position, look_at = fit_camera(points, aspect=camera.aspect, fov_rad=camera.fov)
        with self._client.atomic():
            camera.position = position
            camera.look_at = look_at
        self._left_at, self._shown = position, names

    def follow(self, member: EntityModel | None) -> None:
        """Follow this robot, or nobody."""
        if self._folder is not None:
            self._folder.remove()
        if self._label is not None:
            self._label.remove()
        self._folder = self._text = self._label = None
        self.follows = member.entity if member else ""
        if member:
            self._add_follow_panel(member.entity)

    def move(self, position: Array, *, label_at: Array, has_label: bool) -> None:
        """Bring camera and label nearer to the followed robot; call it often."""
        camera = self._client.camera
        offset = np.array(camera.position) - np.array(camera.look_at)
        distance = float(np.linalg.norm(offset))
        nearer = max(0.0, distance - FOLLOW_DISTANCE_M) * FOLLOW_GAIN
        self._focus = self._focus + (position - self._focus) * FOLLOW_GAIN
        with self._client.atomic():
            camera.position = self._focus + offset * (1.0 - nearer / max(distance, 1e-6))
            camera.look_at = self._focus
            if self._label is not None:
                self._label.position = label_at
                self._label.visible = has_label

    def tell(self, member: EntityModel, state: Array, command: LastCommand | None) -> None:
        """Write about the followed robot."""
        if self._text is not None:
            self._text.content = make_robot_html(member, state, command)

    def warn(self, text: str) -> None:
        """Say once that something did not work."""
        self._client.add_notification("zensim", text, color="orange", auto_close_seconds=6.0)

    def _is_untouched(self) -> bool:
        """Whether the camera is where the page or we have put it; a new page needs a moment."""
        camera = self._client.camera
        has_fov = abs(camera.fov - FOV_RAD) < CAMERA_TOLERANCE
        return has_fov and np.allclose(
            camera.position, self._left_at, rtol=0.0, atol=CAMERA_TOLERANCE
        )

    def _add_follow_panel(self, name: str) -> None:
        self._focus = np.array(self._client.camera.look_at)
        self._label = self._client.scene.add_label(
            "/followed", name, anchor="bottom-center", font_screen_scale=1.3
        )
        self._folder = self._client.gui.add_folder(name)
        with self._folder:
            self._text = self._client.gui.add_html("")
            button = self._client.gui.add_button("Stop following", color=MUTED_BUTTON)
        button.on_click(lambda _: self._release())


TEXT_PERIOD_S: Final = 0.15
"""The panel's text and the names need not keep up with the picture."""


class ClientConnected(msgspec.Struct, frozen=True):
    """Somebody opened the page."""

    visitor: int


class ClientDisconnected(msgspec.Struct, frozen=True):
    """Somebody closed the page."""

    visitor: int


class RobotPicked(msgspec.Struct, frozen=True):
    """Somebody clicked a robot; no entity means that they follow nobody."""

    visitor: int
    entity: str


class ButtonPressed(msgspec.Struct, frozen=True):
    """Somebody pressed a button."""

    button: Button


class ShowAllPressed(msgspec.Struct, frozen=True):
    """Somebody wants to see everybody."""

    visitor: int


ClientEvent = ClientConnected | ClientDisconnected | RobotPicked | ShowAllPressed


class ViewerPage:
    """A page on a port. viser's threads only leave deeds; one thread, the caller's, does the rest.

    Raises:
        PortTaken: Another program listens there.
        CannotListen: This machine does not let us.
    """

    def __init__(self, host: str, port: int) -> None:
        self._deeds: SimpleQueue[ClientEvent | ButtonPressed] = SimpleQueue()
        self._visitors: dict[int, ViewerClient] = {}
        self._fleet, self._frame = RenderedFleet(), RenderedFrame()
        self._names = b"{}"
        self._texts_due = 0.0
        self._server = open_server(host, port, lambda: self._names)
        scene_setup.set_up_scene(self._server)
        self._lighting = SceneLighting(self._server.scene)
        self._lighting.show(Scene())
        self._drawn = FleetNodes(self._server.scene, self._pick)
        self._status = self._server.gui.add_html(make_status_html(SimulationStatus()))
        self._buttons = self._server.gui.add_button_group("Simulation", BUTTONS)
        self._buttons.on_click(
            lambda e: self._deeds.put(ButtonPressed(cast("Button", e.target.value)))
        )
        self._has_names = self._server.gui.add_checkbox(
            "Names", initial_value=False, hint=f"Above robots, the first {MAX_LABELS} of them."
        )
        everybody = self._server.gui.add_button("Show all", color=scene_setup.MUTED_BUTTON)
        everybody.on_click(self._show_all)
        self._server.on_client_connect(
            lambda client: self._deeds.put(ClientConnected(client.client_id))
        )
        self._server.on_client_disconnect(
            lambda client: self._deeds.put(ClientDisconnected(client.client_id))
        )

    @property
    def port(self) -> int:
        """Where the page is."""
        return self._server.get_port()

    @property
    def is_watched(self) -> bool:
        """Whether anybody has the page open."""
        return bool(self._visitors)

    @property
    def followed(self) -> frozenset[str]:
        """The entities that somebody follows."""
        return frozenset(v.follows for v in self._visitors.values() if v.follows)

    def wait_for_input(self, timeout_s: float) -> list[Button]:
        """Wait so long for visitors to do something; return the buttons that they pressed."""
        pressed = []
        with suppress(Empty):
            deed = self._deeds.get(timeout=timeout_s)
            while True:
                if isinstance(deed, ButtonPressed):
                    pressed.append(deed.button)
                else:
                    self._handle_event(deed)
                deed = self._deeds.get_nowait()
        return pressed

    def show(
        self,
        fleet: RenderedFleet,
        frame: RenderedFrame,
        status: SimulationStatus,
        commands: Mapping[str, LastCommand],
    ) -> None:
        """Draw one snapshot."""
        self._fleet, self._frame = fleet, frame
        with self._server.atomic():
            self._lighting.show(fleet.scene)
            self._drawn.show(fleet, frame)
        self._names = self._drawn.names_json()
        for visitor in self._connected_clients():
            visitor.frame_all_if_changed(fleet.names, frame.base[:, :3])
        self.move_cameras()
        if time.monotonic() >= self._texts_due:
            self._texts_due = time.monotonic() + TEXT_PERIOD_S
            self._update_texts(status, commands)

    def move_cameras(self) -> None:
        """Bring every camera nearer to the robot that it follows; call it often."""
        has_label = not self._has_names.value
        for visitor in self._connected_clients():
            if visitor.follows in self._fleet.rows:
                position = self._frame.base[self._fleet.rows[visitor.follows], :3]
                top_m = self._drawn.top_m(self._fleet.forms[visitor.follows]) + LABEL_GAP_M
                label_at = position + np.array((0.0, 0.0, top_m))
                visitor.move(position, label_at=label_at, has_label=has_label)

    def show_disconnected(self) -> None:
        """Show that no server answers."""
        self._status.content = make_status_html(SimulationStatus())

    def warn(self, text: str) -> None:
        """Tell every visitor once."""
        for visitor in self._connected_clients():
            visitor.warn(text)

    def close(self) -> None:
        """Stop serving."""
        close_server(self._server)

    def _connected_clients(self) -> list[ViewerClient]:
        """Visitors that viser still knows: a page may have gone without its deed being read."""
        connected = self._server.get_clients()
        return [visitor for number, visitor in self._visitors.items() if number in connected]

    def _pick(self, visitor: int, entity: str) -> None:
        self._deeds.put(RobotPicked(visitor, entity))

    def _show_all(self, event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
        if event.client_id is not None:
            self._deeds.put(ShowAllPressed(event.client_id))

    def _handle_event(self, deed: ClientEvent) -> None:
        number = deed.visitor
        client = self._server.get_clients().get(number)
        if isinstance(deed, ClientDisconnected) or client is None:
            self._visitors.pop(number, None)
        elif isinstance(deed, ClientConnected):
            self._visitors[number] = ViewerClient(client, lambda: self._pick(number, ""))
        elif isinstance(deed, RobotPicked):
            self._visitors[number].follow(self._fleet.members.get(deed.entity))
        else:
            self._visitors[number].follow(None)
            if self._fleet.names:
                self._visitors[number].look_at_all(self._fleet.names, self._frame.base[:, :3])

    def _update_texts(self, status: SimulationStatus, commands: Mapping[str, LastCommand]) -> None:
        self._status.content = make_status_html(status)
        self._drawn.label(self._fleet, self._frame, is_on=self._has_names.value)
        for visitor in self._connected_clients():
            if visitor.follows in self._fleet.rows:
                state = self._frame.base[self._fleet.rows[visitor.follows]]
                member = self._fleet.members[visitor.follows]
                visitor.tell(member, state, commands.get(visitor.follows))
            else:
                visitor.follow(None)

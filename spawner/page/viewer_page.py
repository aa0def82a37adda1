"""The page of the viewer: scene nodes in viser, cameras and panels of its clients."""

import itertools
import time
from collections.abc import Callable, Container, Mapping, Sequence
from contextlib import suppress
from functools import partial
from queue import Empty, SimpleQueue
from types import MappingProxyType
from typing import Final, cast

import msgspec
import numpy as np
import viser

from zensim.proto.messages.model_messages import DOWNWARD, Light, Origin, Quat
from zensim.proto.messages.telemetry_messages import EntityModel
from zensim.proto.messages.world_messages import Scene
from zensim.proto.se3 import FloatArray
from zensim.spawner.page.model_visuals import (
    Array,
    ColouredMesh,
    TriangleMeshes,
    VisualTemplate,
    encode_glb,
    find_bounds,
    make_link_meshes,
)
from zensim.spawner.page.page_server import OPEN_ACCESS, PageAccess, close_server, open_server
from zensim.spawner.page.render_state import (
    InstanceGroup,
    LastCommand,
    RenderedFleet,
    RenderedFrame,
    SimulationStatus,
    View,
    choose_view,
    fit_camera,
)
from zensim.spawner.page.sensor_views import Picture, SensedFrame, SensorChoice, SensorView
from zensim.spawner.page.side_panel import BUTTONS, Button, make_robot_html, make_status_html

GROUND: Final = (40, 44, 51)
GRID_CELLS: Final = (58, 63, 72)
GRID_METRES: Final = (84, 91, 103)
BRAND: Final = (64, 132, 214)
MUTED_BUTTON: Final = (66, 71, 80)
"""Colour of buttons without effect on the simulation."""
FADE_DISTANCE_M: Final = 45.0
"""Distance at which the ground fades out."""
START_CAMERA: Final = ((-1.5, -1.6, 1.1), (3.0, 0.2, 0.0))
"""Position and target of the camera before there is a robot."""
FOV_RAD: Final = float(np.radians(45.0))


def set_up_scene(server: viser.ViserServer) -> None:
    """Set up an empty page."""
    server.gui.configure_theme(
        dark_mode=True, show_logo=False, show_share_button=False, brand_color=BRAND
    )
    scene = server.scene
    scene.configure_default_lights(enabled=False)
    scene.configure_environment_map(hdri=None)
    scene.add_grid(
        "/ground",
        infinite_grid=True,
        plane_color=GROUND,
        plane_opacity=1.0,
        cell_color=GRID_CELLS,
        cell_size=0.25,
        section_color=GRID_METRES,
        section_size=1.0,
        fade_distance=FADE_DISTANCE_M,
        fade_strength=2.0,
        shadow_opacity=0.45,
    )
    server.initial_camera.fov = FOV_RAD
    server.initial_camera.position, server.initial_camera.look_at = START_CAMERA


SKY_TOP: Final = (24, 27, 33)
SKY_BOTTOM: Final = (52, 57, 66)
SUN_POSITION: Final = (-4.0, 5.0, 8.0)
"""Position of the default light."""
LAMP_DISTANCE_M: Final = 10.0
"""Distance of directional lamps from the origin."""
LAMP_INTENSITY: Final = 2.2
"""Of a white lamp of intensity 1 where its attenuation is 1."""
FIT_DISTANCES_M: Final = (0.5, 5.0)
"""Least and greatest distance at which the attenuation of a lamp is fitted: half of its range."""
SPOT_ANGLE_RAD: Final = 0.8
"""Half angle of the cone of a spot light without an angle."""
AMBIENT_INTENSITY: Final = 3.0
MAX_LIGHTS: Final = 8
"""Limit for the sake of frame rate."""

LightHandle = viser.SceneNodeHandle


class SceneLighting:
    """Lights and background; changed only when the lights change."""

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self._handles: list[LightHandle] = []
        self._lamps: tuple[Light, ...] = ()
        self._lamp_handles: list[LightHandle] = []
        self._shown: tuple[Scene, list[Light]] | None = None

    def show(self, scene: Scene, lights: tuple[Light, ...] = ()) -> None:
        """Show the lights and background of a world.

        Args:
            scene: Of the world.
            lights: Of its models, in the world frame; they may move.
        """
        lamps = (*scene.lights, *lights)[:MAX_LIGHTS]
        shown = (
            scene,
            [msgspec.structs.replace(lamp, origin=Origin(), direction=DOWNWARD) for lamp in lamps],
        )
        if shown == self._shown:
            self._move_lamps(lamps)
            return
        self._shown, self._lamps = shown, lamps
        for handle in (*self._handles, *self._lamp_handles):
            handle.remove()
        self._handles = [self._add_ambient(scene.ambient)]
        self._lamp_handles = [self._add(f"/light/{i}", lamp) for i, lamp in enumerate(lamps)]
        if scene.has_sun or not scene.lights:
            self._handles.append(self._add_sun())
        self._scene.set_background_image(make_sky(scene.background), format="png")

    def _move_lamps(self, lamps: tuple[Light, ...]) -> None:
        for handle, old, lamp in zip(self._lamp_handles, self._lamps, lamps, strict=True):
            if lamp == old:
                continue
            is_far = lamp.kind == "directional"
            handle.position = find_light_position(lamp) if is_far else lamp.origin.position
            if isinstance(handle, viser.SpotLightHandle):
                handle.direction = lamp.direction
        self._lamps = lamps

    def _add_ambient(self, colour: Quat | None) -> LightHandle:
        if colour is not None:
            return self._scene.add_light_ambient(
                "/light/ambient", color=_to_rgb(colour), intensity=AMBIENT_INTENSITY
            )
        return self._scene.add_light_hemisphere(
            "/light/ambient", sky_color=(214, 226, 245), ground_color=(92, 94, 100), intensity=1.6
        )

    def _add_sun(self) -> LightHandle:
        return self._scene.add_light_directional(
            "/light/sun",
            intensity=LAMP_INTENSITY,
            cast_shadow=True,
            position=SUN_POSITION,
        )

    def _add(self, path: str, lamp: Light) -> LightHandle:
        scene, colour, position = self._scene, _to_rgb(lamp.rgba), lamp.origin.position
        if lamp.kind == "directional":
            return scene.add_light_directional(
                path,
                color=colour,
                intensity=LAMP_INTENSITY * lamp.intensity,
                cast_shadow=lamp.casts_shadows,
                position=find_light_position(lamp),
            )
        intensity, decay = fit_attenuation(lamp)
        if lamp.kind == "point":
            return scene.add_light_point(
                path,
                color=colour,
                intensity=intensity,
                decay=decay,
                distance=lamp.range_m,
                position=position,
            )
        return scene.add_light_spot(
            path,
            color=colour,
            intensity=intensity,
            decay=decay,
            distance=lamp.range_m,
            angle=min(lamp.outer_angle_rad / 2.0 or SPOT_ANGLE_RAD, float(np.pi) / 2.0),
            penumbra=0.3,
            cast_shadow=lamp.casts_shadows,
            position=position,
            direction=lamp.direction,
        )


def fit_attenuation(lamp: Light) -> tuple[float, float]:
    """Find intensity and exponent of a power law with the attenuation of a lamp and its slope."""
    near, far = FIT_DISTANCES_M
    distance = min(max(lamp.range_m / 2.0, near), far)
    constant, linear, quadratic = lamp.attenuation
    terms = (constant, linear * distance, quadratic * distance**2)
    whole = max(sum(terms), 1e-3)
    decay = (terms[1] + 2.0 * terms[2]) / whole
    return LAMP_INTENSITY * lamp.intensity * distance**decay / whole, decay


def find_light_position(lamp: Light) -> tuple[float, float, float]:
    """Find a position [m] from which a directional lamp points to the origin."""
    x, y, z = lamp.direction
    length = float(np.linalg.norm(lamp.direction))
    if not np.isfinite(length) or length == 0.0:
        return (0.0, 0.0, LAMP_DISTANCE_M)
    return (
        -x / length * LAMP_DISTANCE_M,
        -y / length * LAMP_DISTANCE_M,
        -z / length * LAMP_DISTANCE_M,
    )


def make_sky(colour: Quat | None = None) -> np.ndarray:
    """Make a background image (rows, columns, 3), uint8: one colour, or a gradient."""
    top, low = (SKY_TOP, SKY_BOTTOM) if colour is None else (_to_rgb(colour),) * 2
    weight = np.linspace(0.0, 1.0, 256)[:, None]
    column = np.asarray(top) * (1.0 - weight) + np.asarray(low) * weight
    image: np.ndarray = np.repeat(column[:, None, :], 4, axis=1).round().astype(np.uint8)
    return image


def _to_rgb(colour: Quat) -> tuple[int, int, int]:
    red, green, blue = (round(255 * min(max(channel, 0.0), 1.0)) for channel in colour[:3])
    return red, green, blue


WXYZ_COLUMNS: Final = [6, 3, 4, 5]
"""Columns of a pose in the quaternion order of viser."""
MAX_LABELS: Final = 100
LABEL_GAP_M: Final = 0.03
LOD_MIN_FACES: Final = 2000
LOD_LEVELS: Final = ((2.0, 0.4), (6.0, 0.1), (20.0, 0.02))
"""Distance [m], and share of faces that are drawn from there; for meshes above the minimum."""

BatchHandle = viser.BatchedMeshHandle | viser.BatchedGlbHandle
ClickEvent = (
    viser.SceneNodePointerEvent[viser.BatchedMeshHandle]
    | viser.SceneNodePointerEvent[viser.BatchedGlbHandle]
)
PickCallback = Callable[[int, str], None]
"""Called with the client and the entity that was clicked."""


class ModelNodes:
    """Scene nodes of one template: a batch per link and colour."""

    def __init__(
        self, template: VisualTemplate, meshes: TriangleMeshes, scene: viser.SceneApi, path: str
    ) -> None:
        self.path = path
        self._scene = scene
        self._parts = [make_link_meshes(shapes, meshes) for shapes in template.links]
        self.bounds = find_bounds(template, self._parts)
        """Lowest and highest corner (2, 3) in the frame of the base."""
        self._batches: list[list[BatchHandle]] = []

    def show(self, links: Sequence[FloatArray]) -> bool:
        """Move all instances; return whether the nodes were created."""
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
        """Register a callback for clicks on instances."""
        for batch in itertools.chain.from_iterable(self._batches):
            batch.on_click(callback)

    def remove(self) -> None:
        """Remove the nodes from the scene."""
        for batch in itertools.chain.from_iterable(self._batches):
            batch.remove()

    def _add(self, path: str, part: ColouredMesh, poses: FloatArray) -> BatchHandle:
        if part.mesh.image:
            return self._add_textured(path, part, poses)
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
            receive_shadow=False,  # artefacts at small faces
        )

    def _add_textured(
        self, path: str, part: ColouredMesh, poses: FloatArray
    ) -> viser.BatchedGlbHandle:
        return self._scene.add_batched_glb(
            path,
            encode_glb(part),
            poses[:, WXYZ_COLUMNS],
            poses[:, :3],
            lod="off",
            receive_shadow=False,
        )


class FleetNodes:
    """Scene nodes of all templates, and optional name labels."""

    def __init__(self, scene: viser.SceneApi, pick: PickCallback) -> None:
        self._scene = scene
        self._pick = pick
        self._paths = (f"/robots/{number}" for number in itertools.count())
        self._nodes: dict[VisualTemplate, ModelNodes] = {}
        self._names: dict[str, tuple[str, ...]] = {}
        self._labels: dict[str, viser.LabelHandle] = {}

    def show(self, fleet: RenderedFleet, frame: RenderedFrame) -> None:
        """Draw all entities of a frame; nodes of deleted entities are removed."""
        for gone in self._nodes.keys() - {group.template for group in fleet.groups}:
            self._names.pop(self._nodes[gone].path, None)
            self._nodes.pop(gone).remove()
        for group, links in zip(fleet.groups, frame.links, strict=True):
            self._show_group(group, links, fleet.meshes)

    def label(self, fleet: RenderedFleet, frame: RenderedFrame, *, is_on: bool) -> None:
        """Show the names of the first `MAX_LABELS` robots, or hide all."""
        positions = self._find_label_positions(fleet, frame) if is_on else {}
        for name in self._labels.keys() - positions.keys():
            self._labels.pop(name).remove()
        for name, position in positions.items():
            if name not in self._labels:
                self._labels[name] = self._scene.add_label(
                    f"/names/{name}", name, anchor="bottom-center"
                )
            self._labels[name].position = position

    def find_bounds(self, template: VisualTemplate) -> Array:
        """Find the lowest and highest corner (2, 3) of a template in the frame of its base."""
        return self._nodes[template].bounds

    def top_m(self, template: VisualTemplate) -> float:
        """Height of a template above its base."""
        return float(self._nodes[template].bounds[1, 2])

    def names_json(self) -> bytes:
        """Encode the names of instances by scene node, for `GET /names`."""
        return msgspec.json.encode(dict(self._names))

    def _show_group(
        self, group: InstanceGroup, links: Sequence[FloatArray], meshes: TriangleMeshes
    ) -> None:
        nodes = self._nodes.get(group.template)
        if nodes is None:
            nodes = ModelNodes(group.template, meshes, self._scene, next(self._paths))
            self._nodes[group.template] = nodes
        self._names[nodes.path] = group.names
        if nodes.show(links):
            nodes.on_click(partial(self._handle_click, nodes.path))

    def _handle_click(self, path: str, event: ClickEvent) -> None:
        names, index = self._names.get(path, ()), event.instance_index
        if index is not None and index < len(names):
            self._pick(event.client_id, names[index])

    def _find_label_positions(
        self, fleet: RenderedFleet, frame: RenderedFrame
    ) -> dict[str, np.ndarray]:
        positions: dict[str, np.ndarray] = {}
        for name in fleet.robots[:MAX_LABELS]:
            top = np.array((0.0, 0.0, self.top_m(fleet.templates[name]) + LABEL_GAP_M))
            positions[name] = frame.base[fleet.rows[name], :3] + top
        return positions


SCAN_COLOUR: Final = (255, 96, 64)
SCAN_POINT_M: Final = 0.04
"""Size of the points of scans."""


class SensorDisplay:
    """Scans in the scene and pictures in the panel of one client.

    Attributes:
        chosen: What is switched on.
    """

    def __init__(self, scene: viser.SceneApi, gui: viser.GuiApi) -> None:
        self._scene, self._gui = scene, gui
        self._points: dict[SensorChoice, FloatArray] = {}
        self._clouds: dict[str, viser.PointCloudHandle] = {}
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
            return
        if choice in self._pictures:
            self._pictures.pop(choice).remove()
        if self._points.pop(choice, None) is not None:
            self._draw_cloud(choice.entity)

    def keep(self, sensors: Container[SensorChoice]) -> None:
        """Switch off what is not among these sensors."""
        for choice in [one for one in self.chosen if one not in sensors]:
            self.switch(choice, is_on=False)

    def show(self, sensed: SensedFrame) -> None:
        """Show what is new of the chosen sensors."""
        new = {one: points for one, points in sensed.points.items() if one in self.chosen}
        self._points |= new
        for entity in {choice.entity for choice in new}:
            self._draw_cloud(entity)
        for choice in self.chosen & sensed.pictures.keys():
            self._show_picture(choice, sensed.pictures[choice])

    def _draw_cloud(self, entity: str) -> None:
        scans = [points for choice, points in self._points.items() if choice.entity == entity]
        if not scans:
            self._clouds.pop(entity).remove()
            return
        points = np.concatenate(scans).astype(np.float32)
        if entity in self._clouds:
            self._clouds[entity].points = points
            return
        self._clouds[entity] = self._scene.add_point_cloud(
            f"/scans/{entity}",
            points,
            SCAN_COLOUR,
            point_size=SCAN_POINT_M,
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


def _report_switch(
    switch: Callable[[SensorChoice, bool], None],
    choice: SensorChoice,
    event: viser.GuiEvent[viser.GuiCheckboxHandle],
) -> None:
    switch(choice, event.target.value)


FOLLOW_GAIN: Final = 0.2
"""Share of the distance to the followed robot that the camera moves per call."""
NO_SENSORS: Final[Mapping[SensorChoice, SensorView]] = MappingProxyType({})
FOLLOW_DISTANCE_M: Final = 1.6
"""Distance of the camera from the followed robot."""
CAMERA_TOLERANCE: Final = 0.01
"""Deviation [m or rad] below which a camera counts as not moved."""


class ViewerClient:
    """A connected client, with camera and follow panel."""

    def __init__(
        self,
        client: viser.ClientHandle,
        release: Callable[[], None],
        switch: Callable[[SensorChoice, bool], None],
    ) -> None:
        self._client = client
        self._release, self._switch = release, switch
        self.sensors = SensorDisplay(client.scene, client.gui)
        self._folder: viser.GuiFolderHandle | None = None
        self._text: viser.GuiHtmlHandle | None = None
        self._label: viser.LabelHandle | None = None
        self._focus = np.zeros(3)
        self._camera_at = np.array(START_CAMERA[0])
        self._shown: tuple[tuple[str, ...], int] = ((), 0)
        self.follows = ""

    def frame_all_if_changed(self, fleet: RenderedFleet, find_view: Callable[[], View]) -> None:
        """Show all when the entities or their meshes change, unless the user moved the camera."""
        shown = (fleet.names, len(fleet.meshes))
        if fleet.names and shown != self._shown and not self.follows and self._is_untouched():
            self.look_at_all(fleet, find_view())

    def look_at_all(self, fleet: RenderedFleet, view: View) -> None:
        """Move the camera so that the view is seen."""
        camera = self._client.camera
        position, look_at = fit_camera(view, aspect=camera.aspect, fov_rad=camera.fov)
        with self._client.atomic():
            camera.position = position
            camera.look_at = look_at
        self._camera_at, self._shown = position, (fleet.names, len(fleet.meshes))

    def follow(
        self, member: EntityModel | None, sensors: Mapping[SensorChoice, SensorView] = NO_SENSORS
    ) -> None:
        """Follow a robot with these sensors; None = stop following."""
        self.sensors.close_panel()
        if self._folder is not None:
            self._folder.remove()
        if self._label is not None:
            self._label.remove()
        self._folder = self._text = self._label = None
        self.follows = member.entity if member else ""
        if member:
            self._add_follow_panel(member.entity, sensors)

    def move(self, position: Array, *, label_at: Array, has_label: bool) -> None:
        """Move camera and label towards the followed robot; call periodically."""
        camera = self._client.camera
        offset = np.array(camera.position) - np.array(camera.look_at)
        distance = float(np.linalg.norm(offset))
        step = max(0.0, distance - FOLLOW_DISTANCE_M) * FOLLOW_GAIN
        self._focus = self._focus + (position - self._focus) * FOLLOW_GAIN
        with self._client.atomic():
            camera.position = self._focus + offset * (1.0 - step / max(distance, 1e-6))
            camera.look_at = self._focus
            if self._label is not None:
                self._label.position = label_at
                self._label.visible = has_label

    def update_text(self, member: EntityModel, state: Array, command: LastCommand | None) -> None:
        """Show the state of the followed robot."""
        if self._text is not None:
            self._text.content = make_robot_html(member, state, command)

    def warn(self, text: str) -> None:
        """Show a notification."""
        self._client.add_notification("zensim", text, color="orange", auto_close_seconds=6.0)

    def _is_untouched(self) -> bool:
        """Whether the camera is where the page put it; that of a new client is invalid at first."""
        camera = self._client.camera
        has_fov = abs(camera.fov - FOV_RAD) < CAMERA_TOLERANCE
        return has_fov and np.allclose(
            camera.position, self._camera_at, rtol=0.0, atol=CAMERA_TOLERANCE
        )

    def _add_follow_panel(self, name: str, sensors: Mapping[SensorChoice, SensorView]) -> None:
        self._focus = np.array(self._client.camera.look_at)
        self._label = self._client.scene.add_label(
            "/followed", name, anchor="bottom-center", font_screen_scale=1.3
        )
        self._folder = self._client.gui.add_folder(name)
        with self._folder:
            self._text = self._client.gui.add_html("")
            button = self._client.gui.add_button("Stop following", color=MUTED_BUTTON)
        button.on_click(lambda _: self._release())
        self.sensors.open_panel(self._folder, sensors, self._switch)


TEXT_PERIOD_S: Final = 0.15
"""Update period of panel text and labels."""


class ClientConnected(msgspec.Struct, frozen=True):
    """A client opened the page."""

    client_id: int


class ClientDisconnected(msgspec.Struct, frozen=True):
    """A client closed the page."""

    client_id: int


class RobotPicked(msgspec.Struct, frozen=True):
    """A client clicked a robot; empty = stop following."""

    client_id: int
    entity: str


class ButtonPressed(msgspec.Struct, frozen=True):
    """A client pressed a button."""

    button: Button


class ShowAllPressed(msgspec.Struct, frozen=True):
    """A client pressed Show all."""

    client_id: int


class SensorSwitched(msgspec.Struct, frozen=True):
    """A client switched a sensor on or off."""

    client_id: int
    choice: SensorChoice
    is_on: bool


ClientEvent = ClientConnected | ClientDisconnected | RobotPicked | ShowAllPressed | SensorSwitched


class ViewerPage:
    """A page on a port. Threads of viser only queue events; the thread of the caller handles them.

    Raises:
        PortTaken: Another program listens on the port.
        CannotListen: The operating system refuses.
    """

    def __init__(self, host: str, port: int, access: PageAccess = OPEN_ACCESS) -> None:
        """Serve a page; see `open_server`."""
        self._events: SimpleQueue[ClientEvent | ButtonPressed] = SimpleQueue()
        self._clients: dict[int, ViewerClient] = {}
        self._fleet, self._frame = RenderedFleet(), RenderedFrame()
        self._names = b"{}"
        self._next_text_at = 0.0
        self._server = open_server(host, port, lambda: self._names, access)
        set_up_scene(self._server)
        self._lighting = SceneLighting(self._server.scene)
        self._lighting.show(Scene())
        self._fleet_nodes = FleetNodes(self._server.scene, self._pick)
        self._status = self._server.gui.add_html(make_status_html(SimulationStatus()))
        self._buttons = self._server.gui.add_button_group("Simulation", BUTTONS)
        self._buttons.on_click(
            lambda e: self._events.put(ButtonPressed(cast("Button", e.target.value)))
        )
        self._has_names = self._server.gui.add_checkbox(
            "Names", initial_value=False, hint=f"Show the names of the first {MAX_LABELS} robots."
        )
        show_all = self._server.gui.add_button("Show all", color=MUTED_BUTTON)
        show_all.on_click(self._show_all)
        self._server.on_client_connect(
            lambda client: self._events.put(ClientConnected(client.client_id))
        )
        self._server.on_client_disconnect(
            lambda client: self._events.put(ClientDisconnected(client.client_id))
        )

    @property
    def port(self) -> int:
        """Port of the page."""
        return self._server.get_port()

    @property
    def is_watched(self) -> bool:
        """Whether a client has the page open."""
        return bool(self._clients)

    @property
    def followed(self) -> frozenset[str]:
        """Entities that a client follows."""
        return frozenset(one.follows for one in self._clients.values() if one.follows)

    @property
    def shown_sensors(self) -> frozenset[SensorChoice]:
        """Sensors that a client shows."""
        return frozenset[SensorChoice]().union(*(o.sensors.chosen for o in self._clients.values()))

    def wait_for_input(self, timeout_s: float) -> list[Button]:
        """Wait for events of clients, and return the pressed buttons."""
        pressed = []
        with suppress(Empty):
            event = self._events.get(timeout=timeout_s)
            while True:
                if isinstance(event, ButtonPressed):
                    pressed.append(event.button)
                else:
                    self._handle_event(event)
                event = self._events.get_nowait()
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
            self._lighting.show(fleet.scene, frame.lights)
            self._fleet_nodes.show(fleet, frame)
        self._names = self._fleet_nodes.names_json()
        for client in self._connected_clients():
            client.frame_all_if_changed(fleet, self._find_view)
            client.sensors.keep(fleet.sensors)
        self.move_cameras()
        if time.monotonic() >= self._next_text_at:
            self._next_text_at = time.monotonic() + TEXT_PERIOD_S
            self._update_texts(status, commands)

    def show_sensors(self, sensed: SensedFrame) -> None:
        """Draw what is new of the shown sensors."""
        for client in self._connected_clients():
            client.sensors.show(sensed)

    def _find_view(self) -> View:
        return choose_view(self._fleet, self._frame, self._fleet_nodes.find_bounds)

    def move_cameras(self) -> None:
        """Move each camera towards the robot that it follows; call periodically."""
        has_label = not self._has_names.value
        for client in self._connected_clients():
            if client.follows in self._fleet.rows:
                position = self._frame.base[self._fleet.rows[client.follows], :3]
                top_m = self._fleet_nodes.top_m(self._fleet.templates[client.follows]) + LABEL_GAP_M
                label_at = position + np.array((0.0, 0.0, top_m))
                client.move(position, label_at=label_at, has_label=has_label)

    def show_disconnected(self) -> None:
        """Show that no server replies."""
        self._status.content = make_status_html(SimulationStatus())

    def warn(self, text: str) -> None:
        """Notify all clients."""
        for client in self._connected_clients():
            client.warn(text)

    def close(self) -> None:
        """Stop serving."""
        close_server(self._server)

    def _connected_clients(self) -> list[ViewerClient]:
        """List the clients that viser still has; disconnect events may be queued."""
        connected = self._server.get_clients()
        return [client for client_id, client in self._clients.items() if client_id in connected]

    def _pick(self, client_id: int, entity: str) -> None:
        self._events.put(RobotPicked(client_id, entity))

    def _switch(self, client_id: int, choice: SensorChoice, is_on: bool) -> None:  # noqa: FBT001
        self._events.put(SensorSwitched(client_id, choice, is_on))

    def _show_all(self, event: viser.GuiEvent[viser.GuiButtonHandle]) -> None:
        if event.client_id is not None:
            self._events.put(ShowAllPressed(event.client_id))

    def _handle_event(self, event: ClientEvent) -> None:
        client_id = event.client_id
        client = self._server.get_clients().get(client_id)
        if isinstance(event, ClientDisconnected) or client is None:
            self._clients.pop(client_id, None)
        elif isinstance(event, ClientConnected):
            self._clients[client_id] = ViewerClient(
                client, lambda: self._pick(client_id, ""), partial(self._switch, client_id)
            )
        elif isinstance(event, RobotPicked):
            views = {o: v for o, v in self._fleet.sensors.items() if o.entity == event.entity}
            self._clients[client_id].follow(self._fleet.members.get(event.entity), views)
        elif isinstance(event, SensorSwitched):
            self._clients[client_id].sensors.switch(event.choice, is_on=event.is_on)
        else:
            self._clients[client_id].follow(None)
            if self._fleet.names:
                self._clients[client_id].look_at_all(self._fleet, self._find_view())

    def _update_texts(self, status: SimulationStatus, commands: Mapping[str, LastCommand]) -> None:
        self._status.content = make_status_html(status)
        self._fleet_nodes.label(self._fleet, self._frame, is_on=self._has_names.value)
        for client in self._connected_clients():
            if client.follows in self._fleet.rows:
                state = self._frame.base[self._fleet.rows[client.follows]]
                member = self._fleet.members[client.follows]
                client.update_text(member, state, commands.get(client.follows))
            else:
                client.follow(None)

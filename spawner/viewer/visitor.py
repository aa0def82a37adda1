"""One open page: its camera, and the robot that it follows. Other pages have their own."""

from collections.abc import Callable
from typing import Final

import numpy as np
import viser

from zensim.proto.messages.telemetry_messages import EntityModel
from zensim.spawner.viewer.kinematics import Array
from zensim.spawner.viewer.panel import robot_html
from zensim.spawner.viewer.scene import LastCommand, framing
from zensim.spawner.viewer.stage import FOV_RAD, QUIET, START

GLIDE: Final = 0.2
"""Share of the way that the camera goes towards the followed robot at each call."""
FOLLOW_DISTANCE_M: Final = 1.6
"""A camera that is farther away comes this close."""
SAME: Final = 0.01
"""Metres or radians by which a camera may be off and yet be where it was put."""


class Visitor:
    """A page that somebody has open."""

    def __init__(self, client: viser.ClientHandle, release: Callable[[], None]) -> None:
        self._client = client
        self._release = release
        self._folder: viser.GuiFolderHandle | None = None
        self._text: viser.GuiHtmlHandle | None = None
        self._label: viser.LabelHandle | None = None
        self._focus = np.zeros(3)
        self._left_at = np.array(START[0])
        self._shown: tuple[str, ...] = ()
        self.follows = ""

    def keep_in_view(self, names: tuple[str, ...], points: Array) -> None:
        """Show everybody whenever somebody comes or goes, until the visitor moves the camera."""
        if names and names != self._shown and not self.follows and self._is_untouched():
            self.look_at_all(names, points)

    def look_at_all(self, names: tuple[str, ...], points: Array) -> None:
        """Point the camera so that everybody is in view."""
        camera = self._client.camera
        position, look_at = framing(points, aspect=camera.aspect, fov_rad=camera.fov)
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
            self._begin(member.entity)

    def move(self, position: Array, *, label_at: Array, has_label: bool) -> None:
        """Bring camera and label nearer to the followed robot; call it often."""
        camera = self._client.camera
        offset = np.array(camera.position) - np.array(camera.look_at)
        distance = float(np.linalg.norm(offset))
        nearer = max(0.0, distance - FOLLOW_DISTANCE_M) * GLIDE
        self._focus = self._focus + (position - self._focus) * GLIDE
        with self._client.atomic():
            camera.position = self._focus + offset * (1.0 - nearer / max(distance, 1e-6))
            camera.look_at = self._focus
            if self._label is not None:
                self._label.position = label_at
                self._label.visible = has_label

    def tell(self, member: EntityModel, state: Array, command: LastCommand | None) -> None:
        """Write about the followed robot."""
        if self._text is not None:
            self._text.content = robot_html(member, state, command)

    def warn(self, text: str) -> None:
        """Say once that something did not work."""
        self._client.add_notification("zensim", text, color="orange", auto_close_seconds=6.0)

    def _is_untouched(self) -> bool:
        """Whether the camera is where the page or we have put it; a new page needs a moment."""
        camera = self._client.camera
        has_fov = abs(camera.fov - FOV_RAD) < SAME
        return has_fov and np.allclose(camera.position, self._left_at, rtol=0.0, atol=SAME)

    def _begin(self, name: str) -> None:
        self._focus = np.array(self._client.camera.look_at)
        self._label = self._client.scene.add_label(
            "/followed", name, anchor="bottom-center", font_screen_scale=1.3
        )
        self._folder = self._client.gui.add_folder(name)
        with self._folder:
            self._text = self._client.gui.add_html("")
            button = self._client.gui.add_button("Stop following", color=QUIET)
        button.on_click(lambda _: self._release())

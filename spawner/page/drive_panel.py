"""The tab "Drive": the selected robot by held buttons, keys or gamepad, or to a point."""

import json
import time
from collections.abc import Callable
from typing import Final

import viser

from zensim.proto.path_following import PathController
from zensim.proto.printable_text import to_html
from zensim.proto.se3 import to_yaw
from zensim.spawner.page.drive_control import STOP, RobotBusy, Velocity, find_scale
from zensim.spawner.page.floor_picking import Act
from zensim.spawner.page.page_theme import MUTED_BUTTON, STOP_BUTTON
from zensim.spawner.page.render_state import RenderedFleet, is_moving
from zensim.spawner.page.robot_colours import Rgb
from zensim.spawner.page.robot_driver import RobotDriver
from zensim.spawner.page.script_messages import ScriptMessage, ZensimDrive, ZensimLeave
from zensim.spawner.page.shortcuts import DRIVE_TO, STOP_ALL, TAKE_OVER
from zensim.spawner.page.side_panel import format_command
from zensim.spawner.page.viewer_client import PageState, Panel, ViewerClient
from zensim.spawner.teleop.drive_twists import find_drive_style

PAD: Final = '<div data-zensim-part="pad"></div>'
"""Place of the held buttons and of Stop, which the page's script fills."""
DRIVING: Final = "drive"
"""Purpose of a click on the floor."""
NO_ROBOT: Final = (
    "Select a robot to drive it: click it, or its row in Entities. Then hold a button of the pad, "
    "or W A S D or the arrows."
)
WARN_AGAIN_S: Final = 3.0
"""Minimum time between two notifications that another visitor drives the robot."""


class DrivePanel(Panel):
    """Drives the first selected robot of a visitor."""

    def __init__(self, client: ViewerClient, driver: RobotDriver) -> None:
        """Add the controls."""
        self._client, self._driver = client, driver
        self._visitor = client.client.client_id
        self._entity = ""
        self._driven = ("", STOP)
        """Namespace and scale of the robot; one value, as the thread that receives reads it."""
        self._warn_at = 0.0
        gui = client.gui
        self._text = gui.add_html("")
        self._share = gui.add_slider(
            "Speed [%]", min=5, max=100, step=5, initial_value=100, hint="Of the robot's limits."
        )
        gui.add_html(PAD)
        self._add_button("Drive to", self.drive_to, f"Then click the floor; {DRIVE_TO.keys}")
        self._take_over = self._add_button(
            "Take over", self.take_over, f"From another visitor; {TAKE_OVER.keys}"
        )
        self._take_over.disabled = True
        self._add_button(
            "Stop all", self.stop_all, f"Stops every robot; {STOP_ALL.keys}", STOP_BUTTON
        )
        client.add_command(DRIVE_TO, self.drive_to)
        client.add_command(TAKE_OVER, self.take_over)
        client.add_command(STOP_ALL, self.stop_all)
        client.receive = self.receive

    def draw(self, state: PageState) -> None:
        """Give the driver the poses of the robots that this visitor has sent to a point."""
        sent = self._driver.list_paths(self._visitor)
        if not sent:
            return
        poses = {}
        for entity, member in state.fleet.members.items():
            if member.namespace in sent and entity in state.fleet.rows:
                base = state.state_of(entity)
                poses[member.namespace] = (float(base[0]), float(base[1]), float(to_yaw(base[3:7])))
        self._driver.observe(poses)

    def update(self, state: PageState) -> None:
        """Show who drives the robot."""
        if not self._robot:
            self._text.content = _make_html(NO_ROBOT)
            return
        who = self._name_driver(state)
        member = state.fleet.members.get(self._entity)
        has_agent = member is not None and member.agent
        note = "" if has_agent else "; it has no agent, so commands have no effect"
        self._text.content = _make_html(f"{self._entity}: driven by {who}{note}")

    def _name_driver(self, state: PageState) -> str:
        driver = self._driver.find_driver(self._robot)
        if driver is not None:
            return "you" if driver == self._visitor else "another visitor"
        is_known = self._entity in state.fleet.rows
        moves = is_known and is_moving(state.state_of(self._entity))
        order = self._client.find_order(self._entity)
        return format_command(state.commands.get(self._entity), moves=moves, order=order)

    def change_selection(self) -> None:
        """Drive the robot that is selected now."""
        before = self._robot
        fleet = self._client.state.fleet
        self._entity = next((one for one in self._client.selected if one in fleet.driven), "")
        self._driven = self._find_driven(fleet)
        if before != self._robot:
            self._client.picker.cancel(DRIVING)
        if before and before != self._robot:
            self._driver.drive(self._visitor, before, STOP)
        if bool(before) != bool(self._robot):
            self._take_over.disabled = not self._robot
            self._client.run_script(f"zensimDrives({json.dumps(bool(self._robot))})")

    def receive(self, message: ScriptMessage) -> None:
        """Handle a message of the page's script; called by the thread that receives it."""
        if isinstance(message, ZensimDrive):
            self._drive(Velocity(message.forward, message.left, message.turn))
        elif isinstance(message, ZensimLeave):
            self._driver.release(self._visitor)

    def stop_all(self) -> None:
        """Stop every robot that has a drive."""
        fleet = self._client.state.fleet
        self._driver.stop_all([fleet.members[name].namespace for name in fleet.driven])

    def take_over(self) -> None:
        """Take the robot from another visitor."""
        if self._require_robot():
            before = self._driver.take_over(self._visitor, self._robot)
            if before is not None:
                self._client.notify(before, f"another visitor has taken over {self._entity}")

    def drive_to(self) -> None:
        """Send the robot to the next point of the floor that is clicked."""
        if not self._require_robot():
            return
        if find_drive_style(self._client.state.fleet.model_of(self._entity).drive).is_steered:
            self._client.warn(
                f"{self._entity} is steered; Drive to is for robots that turn on the spot, "
                "drive it by keys"
            )
        else:
            self._client.picker.pick(DRIVING, self._send_to)

    def _send_to(self, x: float, y: float) -> None:
        robot, scale = self._driven
        speed = max(0.05, scale.forward * self._share.value / 100.0)
        path = PathController([(x, y)], speed)
        self._attempt(lambda: self._driver.follow(self._visitor, robot, path))

    def _find_driven(self, fleet: RenderedFleet) -> tuple[str, Velocity]:
        if not self._entity:
            return "", STOP
        scale = find_scale(fleet.model_of(self._entity).drive)
        return fleet.members[self._entity].namespace, scale

    @property
    def _robot(self) -> str:
        return self._driven[0]

    def _require_robot(self) -> bool:
        if not self._robot:
            self._client.warn("no robot is selected; click one, or a row of Entities")
        return bool(self._robot)

    def _drive(self, deflection: Velocity) -> None:
        (robot, scale), share = self._driven, self._share.value / 100.0
        if robot:
            velocity = Velocity(*(a * b * share for a, b in zip(deflection, scale, strict=True)))
            self._attempt(lambda: self._driver.drive(self._visitor, robot, velocity))

    def _attempt(self, act: Act) -> None:
        try:
            act()
        except RobotBusy as busy:
            if time.monotonic() >= self._warn_at:
                self._warn_at = time.monotonic() + WARN_AGAIN_S
                self._client.warn(str(busy))

    def _add_button(
        self, label: str, act: Callable[[], None], hint: str, colour: Rgb = MUTED_BUTTON
    ) -> viser.GuiButtonHandle:
        button = self._client.gui.add_button(label, hint=hint, color=colour)
        button.on_click(lambda _: self._client.post(act))
        return button


def _make_html(text: str) -> str:
    return f'<div style="padding:.15em .7em;font-size:.85em">{to_html(text)}</div>'

"""PageUser: a visitor of the page without a browser, which uses its controls by their labels."""

import threading
from types import TracebackType
from typing import TYPE_CHECKING, Any

import msgspec
import zstandard
from websockets.exceptions import ConnectionClosed

from tests.integration.page_client import PageList, connect_page, encode_camera, encode_update
from tests.integration.processes import eventually

if TYPE_CHECKING:
    from websockets.sync.client import ClientConnection

HEADER_BYTES = 16


class PageUser:
    """An open page; a thread reads what the server sends.

    Attributes:
        connection: Websocket.
        notifications: Texts of all notifications, oldest first.
        nodes: Names of the nodes of the scene.
        owner: Scope of the nodes of this visitor alone.
        waits_for_click: Whether the page asks for a click in the scene.
        scripts: Sources of scripts that the server had run.
        camera_messages: Number of messages that moved the camera.
    """

    def __init__(self, url: str, cookie: str = "") -> None:
        self.connection: ClientConnection = connect_page(url, cookie=cookie)
        self.notifications: list[str] = []
        self.scripts: list[str] = []
        self.page_list = PageList()
        self.camera_messages = 0
        self._controls: dict[str, dict[str, Any]] = {}
        self._commands: dict[str, str] = {}
        self.nodes: set[str] = set()
        self.owner = ""
        self.waits_for_click = False
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()
        self.connection.send(encode_camera())

    def __enter__(self) -> "PageUser":
        # The state is common to all visitors. The list is sent after all controls of this visitor
        # are there, with their callbacks.
        eventually(lambda: "zensimEntities(" in str(self.scripts), 20.0, "the list of entities")
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the page."""
        self.connection.close()
        self._thread.join()

    def press(self, label: str, option: str = "") -> None:
        """Press a button, or an option of a group of buttons."""
        self.give(label, option or True)

    def give(self, label: str, value: object) -> None:
        """Give a control a value."""
        uuid = str(self.control(label)["uuid"])
        self.connection.send(encode_update(uuid, value=value))

    def run(self, command: str) -> None:
        """Run a command of the palette."""
        uuid = eventually(lambda: self._commands.get(command), 10.0, f"command {command}")
        self.send("CommandTriggerMessage", uuid=uuid)

    def send(self, kind: str, **fields: object) -> None:
        """Send a message."""
        self.connection.send(msgspec.msgpack.encode({"type": kind, **fields}))

    def control(self, label: str) -> dict[str, Any]:
        """Find the control with a label, once it is there."""
        return eventually(lambda: self._find(label), 10.0, f"control {label!r}")

    def value_of(self, label: str) -> Any:  # noqa: ANN401  of any control
        """Return the value of a control."""
        return self.control(label)["value"]

    def options_of(self, label: str) -> list[str]:
        """Return what a dropdown offers."""
        return list(self.control(label)["props"]["options"])

    def wait_for_row(self, entity: str) -> None:
        """Wait until an entity is in the list of the page."""
        eventually(lambda: entity in self.list_rows(), 20.0, f"a row of {entity}")

    def list_rows(self) -> dict[str, str]:
        """Return the status of each entity in the list of the page."""
        return dict(row.split(" · ") for row in self.page_list.rows())

    def act(self, act: str) -> None:
        """Press a button of the page's own controls."""
        self.send("ZensimAct", act=act)

    def texts(self) -> str:
        """Return the content of all texts."""
        found = (one["props"].get("content", "") for one in list(self._controls.values()))
        return "\n".join(map(str, found))

    def list_labels(self) -> frozenset[str]:
        """Return the labels of all visible controls; a hidden row keeps its last one."""
        shown = [one["props"] for one in list(self._controls.values()) if is_visible(one)]
        return frozenset(str(props.get("label", "")) for props in shown) - {""}

    def list_controls(self) -> list[dict[str, Any]]:
        """List the messages that added the controls which are there."""
        return list(self._controls.values())

    def list_commands(self) -> list[str]:
        """List the ids of the commands of the palette."""
        return list(self._commands.values())

    def _find(self, label: str) -> dict[str, Any] | None:
        controls = [one for one in list(self._controls.values()) if is_visible(one)]
        found = [one for one in controls if one["props"].get("label") == label]
        return found[-1] if found else None

    def _read(self) -> None:
        try:
            for frame in self.connection:
                assert isinstance(frame, bytes)
                size = int.from_bytes(frame[8:HEADER_BYTES], "little")
                packed = zstandard.decompress(frame[HEADER_BYTES : HEADER_BYTES + size])
                for message in msgspec.msgpack.decode(packed)["messages"]:
                    self._take(message)
        except ConnectionClosed:
            return

    def _take(self, message: dict[str, Any]) -> None:
        kind = message["type"]
        if kind.startswith("Gui"):
            self._take_control(message)
        elif kind == "RegisterCommandMessage":
            self._commands[message["props"]["label"]] = message["uuid"]
        elif kind == "NotificationShowMessage":
            self.notifications.append(str(message["props"]["body"]))
        elif kind == "RunJavascriptMessage":
            self.scripts.append(str(message["source"]))
            self.page_list.take(self.scripts[-1])
        elif kind == "SetCameraPositionMessage":
            self.camera_messages += 1
        elif kind == "ScenePointerEnableMessage":
            self.waits_for_click = bool(message["modifiers"])
        elif "name" in message and "props" in message:
            self.nodes.add(message["name"])
            self.owner = message.get("owner", "") or self.owner

    def _take_control(self, message: dict[str, Any]) -> None:
        if message["type"] == "GuiUpdateMessage":
            self._update(message)
        elif message["type"] == "GuiRemoveMessage":
            self._controls.pop(message["uuid"], None)
        elif "props" in message:
            self._controls[message["uuid"]] = message

    def _update(self, message: dict[str, Any]) -> None:
        control = self._controls.get(message["uuid"])
        if control is None:
            return
        for name, value in message["updates"].items():
            if name == "value":
                control["value"] = value
            else:
                control["props"][name] = value


def is_visible(control: dict[str, Any]) -> bool:
    """Whether a control is shown, as far as it says so itself."""
    return bool(control["props"].get("visible", True))

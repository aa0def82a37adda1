"""Messages from a viewer page to its server, without a browser."""

from contextlib import suppress
from typing import Any

import msgspec
import viser
import zstandard
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin, Subprotocol

from zensim.spawner.page.entity_list import LETTERS
from zensim.spawner.page.scene_lighting import FOV_RAD, START_CAMERA

PROTOCOL = Subprotocol(f"viser-v{viser.__version__}")


def connect_page(url: str, origin: str = "", cookie: str = "") -> ClientConnection:
    """Connect like a page from `origin`, which defaults to the server."""
    return connect(
        url.replace("http", "ws"),
        subprotocols=[PROTOCOL],
        origin=Origin(origin or url),
        additional_headers={"Cookie": cookie} if cookie else None,
        max_size=None,
        # A visitor that never reads would be ended by its own library.
        ping_interval=None,
    )


def encode_camera() -> bytes:
    """Encode the camera message, the first that a page sends."""
    return _encoded(
        "ViewerCameraMessage",
        wxyz=(1.0, 0.0, 0.0, 0.0),
        position=START_CAMERA[0],
        fov=FOV_RAD,
        near=0.01,
        far=1000.0,
        image_height=800,
        image_width=1280,
        look_at=START_CAMERA[1],
        up_direction=(0.0, 0.0, 1.0),
    )


def encode_click(path: str, instance: int, modifier: str | None = None) -> bytes:
    """Encode a click on one instance of a scene node."""
    return _encoded(
        "SceneNodeClickMessage",
        name=path,
        instance_index=instance,
        ray_origin=(0.0, 0.0, 1.0),
        ray_direction=(0.0, 0.0, -1.0),
        screen_pos=(0.5, 0.5),
        modifier=modifier,
        owner="",
    )


def encode_selection(entity: str) -> bytes:
    """Encode the selection of an entity in the list, or by the address of the page."""
    return _encoded("ZensimSelect", entity=entity)


def encode_act(act: str) -> bytes:
    """Encode a press of a button of the page's own controls."""
    return _encoded("ZensimAct", act=act)


def encode_model(model: str) -> bytes:
    """Encode a press of the picture of a model."""
    return _encoded("ZensimModel", model=model)


def encode_update(uuid: str, **updates: object) -> bytes:
    """Encode new values of the attributes of a control."""
    return _encoded("GuiUpdateMessage", uuid=uuid, updates=updates)


def find_control(connection: ClientConnection, kind: str) -> str:
    """Read messages of the server until one adds a control of this kind; return its uuid."""
    while True:
        for message in read_messages(connection.recv(timeout=5.0)):
            if message["type"] == kind:
                return str(message["uuid"])


def read_messages(frame: str | bytes) -> list[dict[str, Any]]:
    """Read the messages of a frame of the server, without the arrays behind them."""
    assert isinstance(frame, bytes)
    size = int.from_bytes(frame[8:16], "little")
    inner = msgspec.msgpack.decode(zstandard.decompress(frame[16 : 16 + size]))
    return list(inner["messages"])


def encode_share_request() -> bytes:
    """Encode a request for a public address."""
    return _encoded("ShareUrlRequest")


def encode_drive(forward: float = 0.0, left: float = 0.0, turn: float = 0.0) -> bytes:
    """Encode what keys or a gamepad give; zeros when they are released."""
    return _encoded("ZensimDrive", forward=forward, left=left, turn=turn)


def encode_leave() -> bytes:
    """Encode that the page was hidden."""
    return _encoded("ZensimLeave")


def encode_floor_click(x: float, y: float, height_m: float = 5.0) -> bytes:
    """Encode a click on a point of the floor from a height above it; from below it is the sky."""
    return _encoded(
        "ScenePointerMessage",
        event_type="click",
        ray_origin=(x, y, height_m),
        ray_direction=(0.0, 0.0, -1.0),
        screen_pos=((0.5, 0.5),),
        modifier=None,
    )


def _encoded(kind: str, **fields: object) -> bytes:
    return msgspec.msgpack.encode({"type": kind, **fields})


def read_arguments(source: str) -> list[Any]:
    """Read the arguments of a script that calls one function of the page."""
    return list(msgspec.json.decode(f"[{source.partition('(')[2].removesuffix(')')}]"))


class PageList:
    """The list of entities, as the server has sent it to the script of the page."""

    def __init__(self) -> None:
        self.entities: list[list[Any]] = []
        self.letters = ""

    def take(self, source: str) -> None:
        """Take a script of the server."""
        if source.startswith("zensimEntities("):
            self.entities, self.letters = read_arguments(source)[0], ""
        elif source.startswith("zensimStatuses("):
            self.letters = read_arguments(source)[0]

    def rows(self) -> list[str]:
        """List the names and statuses of all entities."""
        statuses = {letter: status for status, letter in LETTERS.items()}
        pairs = zip(self.entities, self.letters, strict=False)
        return [f"{entity[0]} · {statuses[letter]}" for entity, letter in pairs]


NO_CONTROLS = frozenset({"GuiFolderMessage", "RegisterCommandMessage"})
"""Messages with labels that add nothing whose value can be set."""


class PageVisitor:
    """A visitor without a browser; keeps what the server has sent of controls and scene nodes."""

    def __init__(self, connection: ClientConnection) -> None:
        self._connection = connection
        self.controls: dict[str, dict[str, Any]] = {}
        """Properties of controls and folders by uuid, with `kind` and `value`."""
        self.nodes: dict[str, dict[str, Any]] = {}
        """Properties of scene nodes by path, with `kind`."""
        self.notices: list[str] = []
        self.waits_for_clicks = False
        """Whether clicks anywhere in the scene are wanted."""
        self.downloads: list[str] = []
        """Names of files."""
        self.page_list = PageList()
        self.stuck: dict[str, list[Any]] = {}
        """Batch, number and height of the entity that a node sticks to, by node."""

    def read(self) -> None:
        """Take in what has arrived."""
        with suppress(TimeoutError):
            while True:
                for message in read_messages(self._connection.recv(timeout=0.0)):
                    self._take(message)

    def find(self, label: str) -> str:
        """Find the newest control with this label; return its uuid."""
        self.read()
        found = [
            uuid
            for uuid, one in self.controls.items()
            if one.get("label") == label and one["kind"] not in NO_CONTROLS
        ]
        assert found, f"{label!r} is none of {self.labels()}"
        return found[-1]

    def value_of(self, label: str) -> Any:  # noqa: ANN401  of any control
        """Return the value of a control as it is shown."""
        return self.controls[self.find(label)]["value"]

    def labels(self) -> list[str]:
        """List the labels of visible controls and folders."""
        self.read()
        return [
            one["label"]
            for one in self.controls.values()
            if one.get("label") and one.get("visible")
        ]

    def texts(self) -> str:
        """Return the content of all texts."""
        self.read()
        return " ".join(one.get("content") or "" for one in self.controls.values())

    def was_notified(self, text: str) -> bool:
        """Whether a notification has a text."""
        self.read()
        return any(text in notice for notice in self.notices)

    def set(self, label: str, value: object) -> None:
        """Set the value of a control."""
        self._connection.send(encode_update(self.find(label), value=value))

    def _take(self, message: dict[str, Any]) -> None:
        kind = message["type"]
        if kind == "ScenePointerEnableMessage":
            self.waits_for_clicks = bool(message["modifiers"])
        elif kind == "FileTransferStartDownload":
            self.downloads.append(message["filename"])
        elif kind == "NotificationShowMessage":
            self.notices.append(message["props"]["body"])
        elif kind == "RunJavascriptMessage":
            self._take_script(message["source"])
        elif "uuid" in message:
            self._take_control(kind, message["uuid"], message)
        elif "name" in message:
            self._take_node(kind, message["name"], message)

    def _take_script(self, source: str) -> None:
        self.page_list.take(source)
        if source.startswith("zensimStick("):
            self.stuck = {node: more for node, *more in read_arguments(source)[0]}

    def _take_control(self, kind: str, uuid: str, message: dict[str, Any]) -> None:
        if kind == "GuiUpdateMessage":
            control = self.controls.get(uuid, {})
            control.update(message["updates"], updates=control.get("updates", 0) + 1)
        elif kind == "GuiRemoveMessage":
            self.controls.pop(uuid, None)
        elif "props" in message:
            self.controls[uuid] = message["props"] | {"kind": kind, "value": message.get("value")}

    def _take_node(self, kind: str, path: str, message: dict[str, Any]) -> None:
        if kind == "RemoveSceneNodeMessage":
            self.nodes.pop(path, None)
        elif kind == "SceneNodeUpdateMessage":
            self.nodes.get(path, {}).update(message["updates"])
        elif "props" in message:
            self.nodes[path] = message["props"] | {"kind": kind}
        elif path in self.nodes:
            self.nodes[path].update(message)

"""Messages from a viewer page to its server, without a browser."""

import msgspec
import viser
import zstandard
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin, Subprotocol

from zensim.spawner.page.viewer_page import FOV_RAD, START_CAMERA

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


def encode_click(path: str, instance: int) -> bytes:
    """Encode a click on one instance of a scene node."""
    return _encoded(
        "SceneNodeClickMessage",
        name=path,
        instance_index=instance,
        ray_origin=(0.0, 0.0, 1.0),
        ray_direction=(0.0, 0.0, -1.0),
        screen_pos=(0.5, 0.5),
        modifier=None,
        owner="",
    )


def encode_update(uuid: str, **updates: object) -> bytes:
    """Encode new values of the attributes of a control."""
    return _encoded("GuiUpdateMessage", uuid=uuid, updates=updates)


def find_control(connection: ClientConnection, kind: str) -> str:
    """Read messages of the server until one adds a control of this kind; return its uuid."""
    while True:
        frame = connection.recv(timeout=5.0)
        assert isinstance(frame, bytes)
        size = int.from_bytes(frame[8:16], "little")
        inner = msgspec.msgpack.decode(zstandard.decompress(frame[16 : 16 + size]))
        for message in inner["messages"]:
            if message["type"] == kind:
                return str(message["uuid"])


def encode_share_request() -> bytes:
    """Encode a request for a public address."""
    return _encoded("ShareUrlRequest")


def _encoded(kind: str, **fields: object) -> bytes:
    return msgspec.msgpack.encode({"type": kind, **fields})

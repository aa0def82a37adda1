"""Server of the page: requests and messages that it accepts, before viser reads them."""

import asyncio
import gzip
import http
import io
import socket
import ssl
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, suppress
from dataclasses import dataclass, field
from functools import cached_property, lru_cache, partial
from importlib.resources import files
from typing import Any, Final

import rich
import viser
import viser.infra._async_message_buffer
import viser.infra._infra
import websockets.asyncio.server
from viser._messages import RunJavascriptMessage
from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from zensim.proto.web_access import (
    OPEN_ACCESS,
    TOKEN_NAME,
    PageAccess,
    has_token,
    has_token_in_address,
    is_own_origin,
    name_cookie,
    open_listener,
    remove_token,
)
from zensim.spawner.page.page_messages import is_offered, note_control, read_page_message
from zensim.spawner.page.page_tools import Rows, make_tools_script
from zensim.spawner.page.script_messages import DRIVE_SCRIPT, ScriptMessage, read_script_message

HOVER_SCRIPT: Final = """
(() => {
  "use strict";
  const REACH_PX = 10, REFRESH_MS = 1000;
  const tip = document.createElement("div");
  tip.id = "zensim-name";
  tip.style.cssText = "position:fixed;z-index:50;display:none;pointer-events:none;" +
    "padding:2px 8px;border-radius:5px;background:rgba(18,20,24,.88);color:#eef1f5;" +
    "font:600 13px system-ui,sans-serif;white-space:nowrap";
  let names = {}, requestedAt = -Infinity, pointer = null;
  const extents = new WeakMap();

  async function refresh() {
    if (performance.now() - requestedAt < REFRESH_MS) return;
    requestedAt = performance.now();
    const response = await fetch("/names").catch(() => null);
    if (response && response.ok) names = await response.json();
  }

  function extentOf(vertices) {
    if (!extents.has(vertices)) {
      const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
      for (let i = 0; i < vertices.length; i++) {
        low[i % 3] = Math.min(low[i % 3], vertices[i]);
        high[i % 3] = Math.max(high[i % 3], vertices[i]);
      }
      extents.set(vertices, {low, high});
    }
    return extents.get(vertices);
  }

  function turnBack(q, v) {  // by the inverse of the quaternion w x y z
    const [w, x, y, z] = [q[0], -q[1], -q[2], -q[3]];
    const t = [2 * (y * v[2] - z * v[1]), 2 * (z * v[0] - x * v[2]), 2 * (x * v[1] - y * v[0])];
    return [
      v[0] + w * t[0] + y * t[2] - z * t[1],
      v[1] + w * t[1] + z * t[0] - x * t[2],
      v[2] + w * t[2] + x * t[1] - y * t[0],
    ];
  }

  function enter(start, way, {low, high}) {  // distance along the ray to the box, or Infinity
    let near = 0, far = Infinity;
    for (let axis = 0; axis < 3; axis++) {
      const a = (low[axis] - start[axis]) / way[axis], b = (high[axis] - start[axis]) / way[axis];
      if (Number.isNaN(a) || Number.isNaN(b)) continue;
      near = Math.max(near, Math.min(a, b));
      far = Math.min(far, Math.max(a, b));
    }
    return near <= far ? near : Infinity;
  }

  function apply(m, v) {
    const row = (r) => m[r] * v[0] + m[r + 4] * v[1] + m[r + 8] * v[2] + m[r + 12];
    return [row(0), row(1), row(2), row(3)];
  }

  function rayOf(page, box) {
    const {projectionMatrix: {elements: p}, matrixWorld: {elements: m}} = page.camera;
    const x = (pointer.clientX - box.left) / box.width * 2 - 1;
    const y = 1 - (pointer.clientY - box.top) / box.height * 2;
    const v = [(x + p[8]) / p[0], (y + p[9]) / p[5], -1];
    const way = [0, 1, 2].map((r) => m[r] * v[0] + m[r + 4] * v[1] + m[r + 8] * v[2]);
    return {start: [m[12], m[13], m[14]], way};
  }

  function intoFrame(m, v) {
    return [0, 4, 8].map((c) => m[c] * v[0] + m[c + 1] * v[1] + m[c + 2] * v[2]);
  }

  // The first thing under the pointer; else the one whose centre is nearest, if it is near.
  function nearest() {
    const page = window.__viserMutable, tree = window.__viserSceneTree;
    if (!page || !page.camera || !page.canvas || !tree) return "";
    const box = page.canvas.getBoundingClientRect();
    const {projectionMatrix, matrixWorldInverse} = page.camera;
    const ray = rayOf(page, box);
    let hit = "", hitDistance = Infinity, best = "", bestDistance = REACH_PX;
    for (const [path, node] of Object.entries(tree.getState())) {
      const group = /^\\/robots\\/[0-9]+/.exec(path);
      const list = group && names[group[0]];
      const props = node && node.message && node.message.props;
      const object = page.nodeRefFromName[path];
      if (!list || !object || !props || !props.batched_positions) continue;
      const m = object.matrixWorld.elements, all = props.batched_positions;
      const start = intoFrame(m, ray.start.map((v, axis) => v - m[12 + axis]));
      const way = intoFrame(m, ray.way);
      const extent = props.vertices && extentOf(props.vertices);
      for (let i = 0; i < Math.min(list.length, all.length / 3); i++) {
        const place = all.slice(3 * i, 3 * i + 3);
        const turn = props.batched_wxyzs.slice(4 * i, 4 * i + 4);
        if (extent) {
          const from = turnBack(turn, start.map((v, axis) => v - place[axis]));
          const distance = enter(from, turnBack(turn, way), extent);
          if (distance < hitDistance) [hit, hitDistance] = [list[i], distance];
        }
        const clip = apply(projectionMatrix.elements,
          apply(matrixWorldInverse.elements, apply(m, place)));
        if (clip[3] <= 0) continue;
        const x = box.left + (clip[0] / clip[3] + 1) / 2 * box.width;
        const y = box.top + (1 - clip[1] / clip[3]) / 2 * box.height;
        const distance = Math.hypot(x - pointer.clientX, y - pointer.clientY);
        if (distance < bestDistance) [best, bestDistance] = [list[i], distance];
      }
    }
    return hit || best;
  }

  function update() {
    const page = window.__viserMutable;
    const isFree = pointer && page && pointer.target === page.canvas && !pointer.buttons;
    const name = isFree ? nearest() : "";
    tip.style.display = name ? "block" : "none";
    if (!name) return;
    tip.textContent = name;
    tip.style.left = pointer.clientX + 14 + "px";
    tip.style.top = pointer.clientY + 12 + "px";
  }

  addEventListener("DOMContentLoaded", () => document.body.append(tip));
  addEventListener("pointermove", (event) => {
    pointer = event;
    refresh().then(update);
  });
  addEventListener("pointerdown", () => { pointer = null; update(); });
})();
"""


FRONT_END: Final = files("zensim.spawner.page") / "front_end.js"
"""Script of the page's own controls."""
CLOSE_TIMEOUT_S: Final = 0.1
"""Limit of the closing handshake of a websocket."""
TITLE: Final = "zensim"
NAMES_PATH: Final = "/names"
CONTENT_SECURITY_POLICY: Final = (
    "default-src 'none'; script-src 'self' 'unsafe-inline' 'unsafe-eval' blob: data:; "
    "style-src 'unsafe-inline'; img-src data: blob:; font-src data:; worker-src blob: data:; "
    "connect-src 'self' ws://{host} wss://{host} blob: data:; frame-ancestors 'none'; "
    "base-uri 'none'; form-action 'none'"
)
"""viser's page is one file that unpacks itself; it may connect to its own server only."""

REFUSAL: Final = "zensim: open the page by address, as localhost, or by the name of this host\n"

MAX_MESSAGE_BYTES: Final = 64 << 10
"""Limit of a message of a page; a camera is 300 bytes."""
MAX_VISITORS: Final = 50
"""Open pages at the same time; a further one is refused."""
MESSAGES_PER_S: Final = 60.0
"""Messages of one page that are read; further ones wait in its connection."""
BURST_S: Final = 1.0
"""Time for which messages may come faster."""

NO_TOKEN: Final = (
    "zensim: {what}; open the address that the program of this page printed: "
    "http://HOST:PORT/?{name}=TOKEN\n"
)
GET: Final = b"GET "
WRONG_METHOD: Final = (
    b"HTTP/1.1 405 Method Not Allowed\r\nAllow: GET\r\nContent-Length: 0\r\n"
    b"Connection: close\r\n\r\n"
)
CROWDED: Final = f"zensim: {MAX_VISITORS} pages are open, the limit; close one\n"
NamesProvider = Callable[[], bytes]
ScriptCallback = Callable[[int, ScriptMessage], None]


@dataclass(frozen=True)
class PageContent:
    """What the page has besides that of viser.

    Attributes:
        names: Body of `GET /names`.
        shortcuts: Keys and what they do, for its help.
    """

    names: NamesProvider
    shortcuts: Rows


class PageConnection(ServerConnection):
    """Websocket of a page: messages that no page sends are dropped, frequent ones wait."""

    _has_received = False

    take_script_message: Callable[[ServerConnection, ScriptMessage], None] = staticmethod(
        lambda _connection, _message: None
    )
    """Called with the messages of the page's own script, which viser does not get."""

    def data_received(self, data: bytes) -> None:
        """Refuse other methods than GET, which websockets would leave without a response."""
        if not self._has_received and not data.startswith(GET[: len(data)]):
            self.transport.write(WRONG_METHOD)
            self.transport.close()
            return
        self._has_received = True
        super().data_received(data)

    @cached_property
    def _paces(self) -> "tuple[MessagePace, MessagePace]":
        """Paces of messages of viser and of the script: a moving camera must not delay a stop."""
        return MessagePace(), MessagePace()

    async def recv(self, decode: bool | None = None) -> Any:  # noqa: ANN401, FBT001
        """Receive the next message that a page sends."""
        of_viser, of_script = self._paces
        while True:
            raw = await super().recv(decode)
            script_message = read_script_message(raw) if isinstance(raw, bytes) else None
            if script_message is not None:
                self.take_script_message(self, script_message)
                await of_script.wait()
                continue
            await of_viser.wait()
            message = read_page_message(raw)
            if message is not None and is_offered(message):
                return raw


class MessagePace:
    """Delays messages that come more often than `MESSAGES_PER_S`."""

    def __init__(self) -> None:
        """Start with a full burst."""
        self._next_s = 0.0

    async def wait(self) -> None:
        """Wait until the next message is on time."""
        now = time.monotonic()
        self._next_s = max(self._next_s, now - BURST_S) + 1.0 / MESSAGES_PER_S
        if self._next_s > now:
            await asyncio.sleep(self._next_s - now)


class LoopEvent(asyncio.Event):
    """An event that other threads cannot set: viser sets it within its loop as well.

    viser 1.1 sets `asyncio.Event` from the thread that draws, too. While its loop adds a waiter,
    that raises "deque mutated during iteration" in the drawing thread.
    """

    def set(self) -> None:
        """Wake what waits; without effect outside of an event loop."""
        try:
            asyncio.get_running_loop()
        except RuntimeError:
            return
        super().set()


@dataclass
class LoopMessageBuffer(viser.infra._async_message_buffer.AsyncMessageBuffer):  # noqa: SLF001
    """Buffer of viser whose waiters are woken within its loop only; it notes all controls."""

    message_event: asyncio.Event = field(default_factory=LoopEvent)
    woken_for: int = 0
    """Number of messages at the end of the last atomic block that woke the loop."""

    def atomic_end(self) -> None:
        """End an atomic block; without messages that wait, the loop is not woken."""
        with self.buffer_lock:
            self.atomic_counter -= 1
            last = self.message_counter - 1
            # A sender that was woken before may have looked while this block lasted.
            is_behind = min((*self.generator_cursors.values(),), default=last) < last
            is_new = is_behind or self.message_counter != self.woken_for
            has_new = self.atomic_counter == 0 and is_new
            if has_new:
                self.woken_for = self.message_counter
        if has_new:
            with suppress(RuntimeError):  # the loop is closed when the page ends
                self.event_loop.call_soon_threadsafe(self.message_event.set)

    def push(self, message: viser.infra.Message) -> None:
        """Queue a message to a page."""
        note_control(message)
        super().push(message)


class LocalViserServer(viser.ViserServer):
    """A viser server without public tunnels."""

    def request_share_url(self, verbose: bool = True) -> str | None:  # noqa: ARG002, FBT001, FBT002
        """Refuse requests of pages for a public tunnel."""
        return None


class ScriptRelay:
    """Finds which viser client a message of the page's script comes from."""

    def __init__(self, on_script: ScriptCallback) -> None:
        """Relay to a function."""
        self._on_script = on_script
        self.server: viser.ViserServer | None = None

    def make_connection(self, *arguments: Any, **options: Any) -> PageConnection:  # noqa: ANN401  of websockets
        """Make the websocket of a page."""
        connection = PageConnection(*arguments, **options)
        connection.take_script_message = self._relay
        return connection

    def _relay(self, connection: ServerConnection, message: ScriptMessage) -> None:
        if self.server is None:
            return
        live = self.server._websock_server._live_connections  # noqa: SLF001
        for client_id, one in live.items():
            if one is connection:
                self._on_script(client_id, message)


def ignore_script(_client_id: int, _message: ScriptMessage) -> None:
    """Ignore a message of the page's script."""


def open_server(
    host: str,
    port: int,
    names: NamesProvider,
    access: PageAccess = OPEN_ACCESS,
    on_script: ScriptCallback = ignore_script,
    shortcuts: Rows = (),
) -> LocalViserServer:
    """Serve a page on exactly this port; 0 = any free port.

    Args:
        host: An address of this host.
        port: 0 to 65535.
        names: Body of `GET /names`: robot names by scene node as JSON.
        access: Who may open it.
        on_script: Called with the id of a viser client and a message of its script.
        shortcuts: Keys and what they do, for the help of the page.

    Raises:
        OSError: See `PageAccess.make_tls_context`.
        PortTaken: Another program listens on the port.
        CannotListen: The operating system refuses.
    """
    tls = access.make_tls_context()
    listener = open_listener(host, port)
    rich.reconfigure(stderr=True)  # viser prints with it; stdout has the address only
    # A client may disconnect during a write.
    warnings.filterwarnings("ignore", message=r"Queued a \w+ on a closed connection")
    content = PageContent(names, shortcuts)
    process_response = partial(_process_response, host=host, content=content, access=access)
    _replace_message_buffer()
    relay = ScriptRelay(on_script)
    with _patch_serve(listener, process_response, tls, relay) as used, _suppress_stderr():
        relay.server = server = LocalViserServer(host=host, port=port, label=TITLE, verbose=False)
    if not used:
        close_server(server)
        raise RuntimeError(f"viser {viser.__version__} has no replaceable serve function; use 1.1")
    return server


def run_script(client: viser.ClientHandle, source: str) -> None:
    """Run a script in the browser of a client."""
    client.gui._websock_interface.queue_message(RunJavascriptMessage(source=source))  # noqa: SLF001


def close_server(server: viser.ViserServer) -> None:
    """Stop the server without its output."""
    with _suppress_stderr():
        server.stop()


def _replace_message_buffer() -> None:
    vars(viser.infra._infra)["AsyncMessageBuffer"] = LoopMessageBuffer  # noqa: SLF001


@contextmanager
def _patch_serve(
    listener: socket.socket,
    process_response: Callable[..., Response | None],
    tls: ssl.SSLContext | None,
    relay: ScriptRelay,
) -> Iterator[list[bool]]:
    """Replace `serve` by one with the listener and hooks; the yielded list is empty if unused."""
    module, used = vars(websockets.asyncio.server), []
    original: Callable[..., object] = module["serve"]

    def serve(handler: object, _host: str, _port: int, **options: object) -> object:
        used.append(True)
        options |= {
            "process_response": process_response,
            "close_timeout": CLOSE_TIMEOUT_S,
            "create_connection": relay.make_connection,
            "max_size": MAX_MESSAGE_BYTES,
            "ssl": tls,
        }
        return original(handler, sock=listener, **options)

    module["serve"] = serve
    try:
        yield used
    finally:
        module["serve"] = original


def _process_response(
    connection: ServerConnection,
    request: Request,
    response: Response,
    *,
    host: str,
    content: PageContent,
    access: PageAccess,
) -> Response | None:
    """Check origin and token, then add headers, title and script to the response of viser."""
    hosts, origins = (request.headers.get_all(name) for name in ("Host", "Origin"))
    if not is_own_origin(hosts, origins, bound_to=host):
        return connection.respond(http.HTTPStatus.FORBIDDEN, REFUSAL)
    if access.token:
        cookies, cookie = request.headers.get_all("Cookie"), name_cookie(find_port(connection))
        if not has_token(cookies, cookie, access.token):
            return _exchange_token(connection, request, access)
    if response.status_code == http.HTTPStatus.SWITCHING_PROTOCOLS:
        return _refuse_crowd(connection)
    if request.path == NAMES_PATH:
        return _make_json_response(content.names())
    response.headers["Content-Security-Policy"] = CONTENT_SECURITY_POLICY.format(host=hosts[0])
    response.headers["X-Content-Type-Options"] = "nosniff"
    if "html" in response.headers.get("Content-Type", ""):
        _replace_title(response, content.shortcuts)
    return None


def _refuse_crowd(connection: ServerConnection) -> Response | None:
    if len(connection.server.connections) < MAX_VISITORS:
        return None
    return connection.respond(http.HTTPStatus.SERVICE_UNAVAILABLE, CROWDED)


def _exchange_token(connection: ServerConnection, request: Request, access: PageAccess) -> Response:
    """Exchange the secret in the address for a cookie, so that the address has it no longer."""
    if not has_token_in_address(request.path, access.token):
        has_one = f"{TOKEN_NAME}=" in request.path
        what = "the token of this address is not valid" if has_one else "this address lacks a token"
        return connection.respond(
            http.HTTPStatus.UNAUTHORIZED, NO_TOKEN.format(what=what, name=TOKEN_NAME)
        )
    response = connection.respond(http.HTTPStatus.SEE_OTHER, "")
    response.headers["Location"] = remove_token(request.path)
    # Lax: a link to a view in a mail opens the page. Requests of other sites have no cookie, but
    # for such a link, which only reads; see also `is_own_origin`.
    attributes = "HttpOnly; SameSite=Lax; Path=/" + ("; Secure" if access.certificate else "")
    cookie = name_cookie(find_port(connection))
    response.headers["Set-Cookie"] = f"{cookie}={access.token}; {attributes}"
    return response


def find_port(connection: ServerConnection) -> int:
    """Find the port that a browser has connected to."""
    return int(connection.local_address[1])


def _replace_title(response: Response, shortcuts: Rows) -> None:
    is_packed = response.headers.get("Content-Encoding") == "gzip"
    response.body = _with_title(bytes(response.body), shortcuts, is_packed=is_packed)
    del response.headers["Content-Length"]
    response.headers["Content-Length"] = str(len(response.body))


@lru_cache(maxsize=4)
def _with_title(body: bytes, shortcuts: Rows, *, is_packed: bool) -> bytes:
    page = gzip.decompress(body) if is_packed else body
    parts = (HOVER_SCRIPT, DRIVE_SCRIPT, make_tools_script(shortcuts), FRONT_END.read_text("utf-8"))
    scripts = "".join(f"<script>{part}</script>" for part in parts)
    head = f"<title>{TITLE}</title>{scripts}".encode()
    titled = page.replace(b"<title>Viser</title>", head, 1)
    return gzip.compress(titled) if is_packed else titled


def _make_json_response(body: bytes) -> Response:
    headers = {"Content-Type": "application/json", "Content-Length": str(len(body))}
    return Response(http.HTTPStatus.OK, "OK", Headers(headers), body)


def _suppress_stderr() -> redirect_stderr[io.StringIO]:
    return redirect_stderr(io.StringIO())

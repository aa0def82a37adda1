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
from zensim.spawner.page.page_files import read_page_file
from zensim.spawner.page.page_messages import is_offered, note_control, read_page_message
from zensim.spawner.page.page_tools import Rows, make_tools_script
from zensim.spawner.page.script_messages import ScriptMessage, read_script_message

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
    hover, keys, own = (
        read_page_file(name) for name in ("hover_names.js", "drive_keys.js", "front_end.js")
    )
    parts = (hover, keys, make_tools_script(shortcuts), own)
    scripts = "".join(f"<script>{part}</script>" for part in parts)
    head = f"<title>{TITLE}</title>{scripts}".encode()
    titled = page.replace(b"<title>Viser</title>", head, 1)
    return gzip.compress(titled) if is_packed else titled


def _make_json_response(body: bytes) -> Response:
    headers = {"Content-Type": "application/json", "Content-Length": str(len(body))}
    return Response(http.HTTPStatus.OK, "OK", Headers(headers), body)


def _suppress_stderr() -> redirect_stderr[io.StringIO]:
    return redirect_stderr(io.StringIO())

"""HTTP side of the page: port, allowed origins, headers, and the script that shows robot names.

viser 1.1 uses the next port if one is taken, and accepts requests of any web page. It calls
`websockets.asyncio.server.serve`, which has hooks for both. `open_server` replaces this function
by one that sets the hooks, while viser creates its server.
"""

import errno
import gzip
import http
import io
import os
import socket
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stderr
from functools import lru_cache, partial
from ipaddress import ip_address
from typing import Final
from urllib.parse import SplitResult, urlsplit

import rich
import viser
import websockets.asyncio.server
from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

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
      let extent = 0;
      for (let i = 0; i < vertices.length; i += 3) {
        extent = Math.max(extent, Math.hypot(vertices[i], vertices[i + 1], vertices[i + 2]));
      }
      extents.set(vertices, extent);
    }
    return extents.get(vertices);
  }

  function apply(m, v) {
    const row = (r) => m[r] * v[0] + m[r + 4] * v[1] + m[r + 8] * v[2] + m[r + 12];
    return [row(0), row(1), row(2), row(3)];
  }

  function nearest() {
    const page = window.__viserMutable, tree = window.__viserSceneTree;
    if (!page || !page.camera || !page.canvas || !tree) return "";
    const box = page.canvas.getBoundingClientRect();
    const {projectionMatrix, matrixWorldInverse} = page.camera;
    let best = "", bestDistance = 1;
    for (const [path, node] of Object.entries(tree.getState())) {
      const group = /^\\/robots\\/[0-9]+/.exec(path);
      const list = group && names[group[0]];
      const props = node && node.message && node.message.props;
      const object = page.nodeRefFromName[path];
      if (!list || !object || !props || !props.batched_positions) continue;
      const all = props.batched_positions, extent = extentOf(props.vertices);
      for (let i = 0; i < Math.min(list.length, all.length / 3); i++) {
        const world = apply(object.matrixWorld.elements, all.slice(3 * i, 3 * i + 3));
        const clip = apply(projectionMatrix.elements, apply(matrixWorldInverse.elements, world));
        if (clip[3] <= 0) continue;
        const x = box.left + (clip[0] / clip[3] + 1) / 2 * box.width;
        const y = box.top + (1 - clip[1] / clip[3]) / 2 * box.height;
        const size = projectionMatrix.elements[5] * extent / clip[3] / 2 * box.height;
        const distance = Math.hypot(x - pointer.clientX, y - pointer.clientY) /
          Math.max(REACH_PX, size);
        if (distance < bestDistance) [best, bestDistance] = [list[i], distance];
      }
    }
    return best;
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

NamesProvider = Callable[[], bytes]


class PortTaken(OSError):
    """Another program listens on the port."""


class CannotListen(OSError):
    """The address does not belong to this host, or its use is not permitted."""


class LocalViserServer(viser.ViserServer):
    """A viser server without public tunnels."""

    def request_share_url(self, verbose: bool = True) -> str | None:  # noqa: ARG002, FBT001, FBT002
        """Refuse requests of pages for a public tunnel."""
        return None


def open_server(host: str, port: int, names: NamesProvider) -> LocalViserServer:
    """Serve a page on exactly this port; 0 = any free port.

    Args:
        host: An address of this host.
        port: 0 to 65535.
        names: Body of `GET /names`: robot names by scene node as JSON.

    Raises:
        PortTaken: Another program listens on the port.
        CannotListen: The operating system refuses.
    """
    listener = _open_listener(host, port)
    rich.reconfigure(stderr=True)  # viser prints with it; stdout has the address only
    # A client may disconnect during a write.
    warnings.filterwarnings("ignore", message=r"Queued a \w+ on a closed connection")
    with (
        _patch_serve(listener, partial(_process_response, host=host, names=names)) as used,
        _suppress_stderr(),
    ):
        server = LocalViserServer(host=host, port=port, label=TITLE, verbose=False)
    if not used:
        close_server(server)
        raise RuntimeError(f"viser {viser.__version__} has no replaceable serve function; use 1.1")
    return server


def close_server(server: viser.ViserServer) -> None:
    """Stop the server without its output."""
    with _suppress_stderr():
        server.stop()


def is_own_origin(hosts: Sequence[str], origins: Sequence[str], *, bound_to: str) -> bool:
    """Whether a request comes from a page of this server.

    A page of another site sends the Origin of that site. With DNS rebinding, both headers have
    the name of the other site, so the name must be one of this host, too. Programs other than
    browsers send no Origin.

    Args:
        hosts: Host headers; exactly one is valid.
        origins: Origin headers.
        bound_to: Address that the page is served on.
    """
    if len(hosts) != 1 or len(origins) > 1:
        return False
    name = _split_url(f"//{hosts[0]}").hostname or ""
    own_name = socket.gethostname().lower()
    is_own = name in {"localhost", bound_to.lower(), own_name, f"{own_name}.local"}
    if not is_own and not _is_address(name):
        return False
    return all(_split_url(origin).netloc.lower() == hosts[0].lower() for origin in origins)


def _open_listener(host: str, port: int) -> socket.socket:
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        return socket.create_server((host, port), family=family)
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise PortTaken(
                f"port {port} on {host} is used by another program; stop it or use --port"
            ) from error
        is_numbered = error.errno is not None and error.errno > 0  # others are of the resolver
        reason = os.strerror(error.errno or 0) if is_numbered else error.strerror
        raise CannotListen(
            f"cannot listen on {host} port {port}: {reason}; use an address of this host"
        ) from error


@contextmanager
def _patch_serve(
    listener: socket.socket, process_response: Callable[..., Response | None]
) -> Iterator[list[bool]]:
    """Replace `serve` by one with the listener and hooks; the yielded list is empty if unused."""
    module, used = vars(websockets.asyncio.server), []
    original: Callable[..., object] = module["serve"]

    def serve(handler: object, _host: str, _port: int, **options: object) -> object:
        used.append(True)
        options |= {"process_response": process_response, "close_timeout": CLOSE_TIMEOUT_S}
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
    names: NamesProvider,
) -> Response | None:
    """Check the origin, then add headers, title and script to the response of viser."""
    hosts, origins = (request.headers.get_all(name) for name in ("Host", "Origin"))
    if not is_own_origin(hosts, origins, bound_to=host):
        return connection.respond(http.HTTPStatus.FORBIDDEN, REFUSAL)
    if response.status_code == http.HTTPStatus.SWITCHING_PROTOCOLS:
        return None
    if request.path == NAMES_PATH:
        return _make_json_response(names())
    response.headers["Content-Security-Policy"] = CONTENT_SECURITY_POLICY.format(host=hosts[0])
    response.headers["X-Content-Type-Options"] = "nosniff"
    if "html" in response.headers.get("Content-Type", ""):
        _replace_title(response)
    return None


def _replace_title(response: Response) -> None:
    is_packed = response.headers.get("Content-Encoding") == "gzip"
    response.body = _with_title(bytes(response.body), is_packed=is_packed)
    del response.headers["Content-Length"]
    response.headers["Content-Length"] = str(len(response.body))


@lru_cache(maxsize=2)
def _with_title(body: bytes, *, is_packed: bool) -> bytes:
    page = gzip.decompress(body) if is_packed else body
    head = f"<title>{TITLE}</title><script>{HOVER_SCRIPT}</script>".encode()
    titled = page.replace(b"<title>Viser</title>", head, 1)
    return gzip.compress(titled) if is_packed else titled


def _make_json_response(body: bytes) -> Response:
    headers = {"Content-Type": "application/json", "Content-Length": str(len(body))}
    return Response(http.HTTPStatus.OK, "OK", Headers(headers), body)


def _suppress_stderr() -> redirect_stderr[io.StringIO]:
    return redirect_stderr(io.StringIO())


def _split_url(url: str) -> SplitResult:
    """Split a URL; an invalid one becomes empty."""
    try:
        parts = urlsplit(url)
        _ = parts.port
    except ValueError:
        return urlsplit("")
    return parts


def _is_address(name: str) -> bool:
    try:
        ip_address(name)
    except ValueError:
        return False
    return True

"""How viser serves the page: port, allowed origins, headers, robots' names and the script that shows them.

viser 1.1 takes the next port when one is taken and accepts any web page. It calls
`websockets.asyncio.server.serve`, which has a hook for each of these; `open_server` replaces that
`serve` with one that sets them, while a server is being made.
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
  let names = {}, askedAt = -Infinity, pointer = null;
  const extents = new WeakMap();

  async function refresh() {
    if (performance.now() - askedAt < REFRESH_MS) return;
    askedAt = performance.now();
    const answer = await fetch("/names").catch(() => null);
    if (answer && answer.ok) names = await answer.json();
  }

  function extentOf(vertices) {
    if (!extents.has(vertices)) {
      let most = 0;
      for (let i = 0; i < vertices.length; i += 3) {
        most = Math.max(most, Math.hypot(vertices[i], vertices[i + 1], vertices[i + 2]));
      }
      extents.set(vertices, most);
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
      const cohort = /^\\/robots\\/[0-9]+/.exec(path);
      const list = cohort && names[cohort[0]];
      const props = node && node.message && node.message.props;
      const object = page.nodeRefFromName[path];
      if (!list || !object || !props || !props.batched_positions) continue;
      const all = props.batched_positions, extent = extentOf(props.vertices);
      for (let i = 0; i < Math.min(list.length, all.length / 3); i++) {
        const world = apply(object.matrixWorld.elements, all.slice(3 * i, 3 * i + 3));
        const seen = apply(projectionMatrix.elements, apply(matrixWorldInverse.elements, world));
        if (seen[3] <= 0) continue;
        const x = box.left + (seen[0] / seen[3] + 1) / 2 * box.width;
        const y = box.top + (1 - seen[1] / seen[3]) / 2 * box.height;
        const size = projectionMatrix.elements[5] * extent / seen[3] / 2 * box.height;
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
"""What a page gets to say goodbye."""
TITLE: Final = "zensim"
NAMES_PATH: Final = "/names"
CONTENT_SECURITY_POLICY: Final = (
    "default-src 'none'; script-src 'self' 'unsafe-inline' 'unsafe-eval' blob: data:; "
    "style-src 'unsafe-inline'; img-src data: blob:; font-src data:; worker-src blob: data:; "
    "connect-src 'self' ws://{host} wss://{host} blob: data:; frame-ancestors 'none'; "
    "base-uri 'none'; form-action 'none'"
)
"""viser's page is one file that unpacks itself; it may talk to nobody but its server."""

REFUSAL: Final = "zensim: open the page itself, by address, localhost or this machine's name\n"

NamesProvider = Callable[[], bytes]


class PortTaken(OSError):
    """Another program listens there."""


class CannotListen(OSError):
    """The address is not one of this machine, or not ours to use."""


class LocalViserServer(viser.ViserServer):
    """A viser server that has no public tunnel."""

    def request_share_url(self, verbose: bool = True) -> str | None:  # noqa: ARG002, FBT001, FBT002
        """Refuse: a page may ask for a tunnel, but nobody gets one."""
        return None


def open_server(host: str, port: int, names: NamesProvider) -> LocalViserServer:
    """Serve a page on this port or not at all; 0 is any free port.

    Args:
        host: An address of this machine.
        port: 0 to 65535.
        names: What `GET /names` answers: JSON, robots' names by scene node.

    Raises:
        PortTaken: Another program listens there.
        CannotListen: This machine does not let us.
    """
    listener = _open_listener(host, port)
    rich.reconfigure(stderr=True)  # viser prints with it; stdout is for our own line
    # A page that closes while it is being written to is nothing to report.
    warnings.filterwarnings("ignore", message=r"Queued a \w+ on a closed connection")
    with (
        _patch_serve(listener, partial(_process_response, host=host, names=names)) as used,
        _suppress_stderr(),
    ):
        server = LocalViserServer(host=host, port=port, label=TITLE, verbose=False)
    if not used:
        close_server(server)
        raise RuntimeError(f"viser {viser.__version__} does not serve as this page needs; use 1.1")
    return server


def close_server(server: viser.ViserServer) -> None:
    """Stop serving; say nothing."""
    with _suppress_stderr():
        server.stop()


def is_own_origin(hosts: Sequence[str], origins: Sequence[str], *, bound_to: str) -> bool:
    """Whether a request comes from a page of this server.

    A page of another site carries that site's Origin. A site whose name is made to point at this
    machine carries its own name in both headers, so the name must be one of ours as well. A
    program that is no browser sends no Origin.

    Args:
        hosts: The request's Host headers; there must be one.
        origins: Its Origin headers.
        bound_to: The address that the page was asked to be served on.
    """
    if len(hosts) != 1 or len(origins) > 1:
        return False
    name = _split_url(f"//{hosts[0]}").hostname or ""
    machine = socket.gethostname().lower()
    is_ours = name in {"localhost", bound_to.lower(), machine, f"{machine}.local"}
    if not is_ours and not _is_address(name):
        return False
    return all(_split_url(origin).netloc.lower() == hosts[0].lower() for origin in origins)


def _open_listener(host: str, port: int) -> socket.socket:
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        return socket.create_server((host, port), family=family)
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise PortTaken(
                f"port {port} on {host} is taken by another program; stop it or use --port"
            ) from error
        is_numbered = error.errno is not None and error.errno > 0  # others are the resolver's
        reason = os.strerror(error.errno or 0) if is_numbered else error.strerror
        raise CannotListen(
            f"cannot listen on {host} port {port}: {reason}; use an address of this machine"
        ) from error


@contextmanager
def _patch_serve(
    listener: socket.socket, answer: Callable[..., Response | None]
) -> Iterator[list[bool]]:
    """Lend viser a `serve` that uses our socket and hooks; what is yielded tells whether it did."""
    module, used = vars(websockets.asyncio.server), []
    real: Callable[..., object] = module["serve"]

    def serve(handler: object, _host: str, _port: int, **options: object) -> object:
        used.append(True)
        options |= {"process_response": answer, "close_timeout": CLOSE_TIMEOUT_S}
        return real(handler, sock=listener, **options)

    module["serve"] = serve
    try:
        yield used
    finally:
        module["serve"] = real


def _process_response(
    connection: ServerConnection,
    request: Request,
    response: Response,
    *,
    host: str,
    names: NamesProvider,
) -> Response | None:
    """Check who asks, then add to viser's answer what it lacks."""
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
    named = page.replace(b"<title>Viser</title>", head, 1)
    return gzip.compress(named) if is_packed else named


def _make_json_response(body: bytes) -> Response:
    headers = {"Content-Type": "application/json", "Content-Length": str(len(body))}
    return Response(http.HTTPStatus.OK, "OK", Headers(headers), body)


def _suppress_stderr() -> redirect_stderr[io.StringIO]:
    return redirect_stderr(io.StringIO())


def _split_url(url: str) -> SplitResult:
    """Split a URL; of one that is none, nothing is left."""
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

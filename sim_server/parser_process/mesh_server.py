"""Files of spawned descriptions by http, so that RViz on any host finds the meshes they name."""

from __future__ import annotations

import html
import mimetypes
import os
import posixpath
import re
import secrets
import socket
from collections import OrderedDict
from contextlib import suppress
from hashlib import sha256
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler
from typing import TYPE_CHECKING, Final
from urllib.parse import quote, unquote, urlsplit

from zensim.proto.bounded_http_server import BoundedHttpRequest, BoundedHttpServer

if TYPE_CHECKING:
    from collections.abc import Mapping

    from zensim.proto.messages.asset_messages import AssetRef

MAX_BUNDLES: Final = 1024
"""Sets of files of descriptions; the least recently spawned ones are forgotten first."""
MAX_TEXTS: Final = 64
"""Descriptions that are kept with their URLs."""
EVERY_ADDRESS: Final = ("0.0.0.0", "::")
BUNDLE_DIGITS: Final = 16
URL_VALUE: Final = re.compile(r"""(?<=["'>])[^"'<>]{1,4096}(?=["'<])""")
"""A value of an attribute or element that may be a URI."""
TYPES: Final = {".dae": "model/vnd.collada+xml", ".stl": "model/stl", ".obj": "model/obj"}


def to_path(uri: str) -> str:
    """Convert a URI of a file to a path below that of its description.

    Relative references of a mesh to its textures remain valid.
    """
    _, separator, path = uri.rpartition("://")
    return posixpath.normpath(f"/{path if separator else uri}").lstrip("/")


class PublishedFiles:
    """Which files of spawned descriptions are offered, by path; threads look them up."""

    def __init__(self, base_url: str) -> None:
        """Offer nothing yet.

        Args:
            base_url: Ends with a slash.
        """
        self.base_url = base_url
        self._bundles: OrderedDict[str, Mapping[str, str]] = OrderedDict()
        self._texts: OrderedDict[tuple[str, tuple[AssetRef, ...]], str] = OrderedDict()

    def publish(self, text: str, files: tuple[AssetRef, ...]) -> str:
        """Offer the files of a description; return it with their URLs instead of their URIs."""
        if not files:
            return text
        key = (text, files)
        if key not in self._texts:
            self._texts[key] = self._publish(text, files)
        self._texts.move_to_end(key)
        while len(self._texts) > MAX_TEXTS:
            self._texts.popitem(last=False)
        return self._texts[key]

    def find(self, path: str) -> str:
        """Find the sha256 of a file by the path of its URL below the base; empty if none is."""
        bundle, _, file = posixpath.normpath(f"/{unquote(path)}").lstrip("/").partition("/")
        return self._bundles.get(bundle, {}).get(file, "")

    def _publish(self, text: str, files: tuple[AssetRef, ...]) -> str:
        by_path = {to_path(one.uri): one.sha256 for one in files}
        listed = "\n".join(f"{path} {name}" for path, name in sorted(by_path.items()))
        bundle = sha256(listed.encode()).hexdigest()[:BUNDLE_DIGITS]
        self._bundles[bundle] = by_path
        while len(self._bundles) > MAX_BUNDLES:
            self._bundles.popitem(last=False)
        urls = {one.uri: f"{self.base_url}{bundle}/{quote(to_path(one.uri))}" for one in files}

        def replace(found: re.Match[str]) -> str:
            return urls.get(html.unescape(found[0]).strip(), found[0])

        return URL_VALUE.sub(replace, text)


class MeshServer(BoundedHttpServer):
    """Serves the files of spawned descriptions, and nothing else, in threads."""

    def __init__(self, address: str, folder: str, *, has_secret: bool = False) -> None:
        """Listen, and serve from now on.

        Args:
            address: `HOST:PORT`; port 0 = any free one.
            folder: Of the files, named `<sha256>.stl`.
            has_secret: Whether URLs contain a secret that only readers of descriptions have.

        Raises:
            OSError: The address cannot be used.
        """
        host, _, port = address.rpartition(":")
        host = host.strip("[]")
        self._folder = folder
        super().__init__(host, int(port), FileRequest)
        shown = socket.gethostname() if host in EVERY_ADDRESS else host
        shown = f"[{shown}]" if ":" in shown else shown
        self.secret = secrets.token_urlsafe() if has_secret else ""
        start = f"{self.secret}/" if has_secret else ""
        self.files = PublishedFiles(f"http://{shown}:{self.port}/{start}")
        self.start("meshes")

    def open_file(self, path: str) -> int | None:
        """Open the file at a URL's path for reading; None if no description has it."""
        start, separator, rest = path.lstrip("/").partition("/") if self.secret else ("", "/", path)
        is_admitted = secrets.compare_digest(start.encode(), self.secret.encode())
        name = self.files.find(rest) if is_admitted and separator else ""
        if not name:
            return None
        with suppress(OSError):
            return os.open(f"{self._folder}/{name}.stl", os.O_RDONLY | os.O_NOFOLLOW)
        return None  # evicted


class FileRequest(BoundedHttpRequest, BaseHTTPRequestHandler):
    """One request; the connection is closed after it."""

    server: MeshServer

    def do_GET(self) -> None:
        """Send a file."""
        self._send(has_body=True)

    def do_HEAD(self) -> None:
        """Send the length of a file."""
        self._send(has_body=False)

    def _send(self, *, has_body: bool) -> None:
        path = urlsplit(self.path).path
        if (descriptor := self.server.open_file(path)) is None:
            self.send_error(HTTPStatus.NOT_FOUND)
            return
        with os.fdopen(descriptor, "rb") as file:
            suffix = posixpath.splitext(path)[1].lower()
            usual = mimetypes.guess_type(path)[0] or "application/octet-stream"
            self.send_response(HTTPStatus.OK)
            self.send_header("Content-Type", TYPES.get(suffix, usual))
            self.send_header("Content-Length", str(os.fstat(descriptor).st_size))
            self.send_header("X-Content-Type-Options", "nosniff")
            self.end_headers()
            if has_body:
                self.wfile.flush()
                self.connection.sendfile(file)

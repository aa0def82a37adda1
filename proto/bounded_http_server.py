"""An http server in threads that clients cannot exhaust: few connections, each for a short time.

Pages of other sites reach none: see `is_own_origin`.
"""

import socket
import threading
import time
from contextlib import suppress
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from socketserver import TCPServer
from typing import Final

from zensim.proto.web_access import is_own_origin

MAX_CONNECTIONS: Final = 32
"""Most connections at a time; further ones are closed at once."""
ACCEPT_PAUSE_S: Final = 0.002
"""Pause after each connection: whoever opens them as fast as possible must not delay steps."""
IDLE_S: Final = 5.0
"""Wall time after which a client that neither sends nor receives is cut off."""
LONGEST_S: Final = 60.0


class BoundedHttpServer(ThreadingHTTPServer):
    """Serves requests in threads, from `start` to `close`."""

    daemon_threads = True
    request_queue_size = MAX_CONNECTIONS
    longest_s = LONGEST_S
    """Longest duration of a connection [s]."""

    def __init__(self, host: str, port: int, handler: type[BaseHTTPRequestHandler]) -> None:
        """Listen; 0 = any free port.

        Raises:
            OSError: The address cannot be used.
        """
        if ":" in host:
            self.address_family = socket.AF_INET6
        self.host = host
        """Address that is served."""
        self._began_s: dict[socket.socket, float] = {}
        self._thread: threading.Thread | None = None
        super().__init__((host, port), handler)

    @property
    def port(self) -> int:
        """TCP port."""
        return int(self.server_address[1])

    def start(self, thread_name: str) -> None:
        """Serve from now on."""
        self._thread = threading.Thread(target=self.serve_forever, name=thread_name, daemon=True)
        self._thread.start()

    def count_connections(self) -> int:
        """Count the connections that are served now."""
        return len(self._began_s)

    def server_bind(self) -> None:
        """Bind without a look-up of the host's name, which can take seconds."""
        TCPServer.server_bind(self)

    def get_request(self) -> tuple[socket.socket, object]:
        """Accept a connection; not too many at a time."""
        time.sleep(ACCEPT_PAUSE_S)
        return super().get_request()

    def process_request(self, request: socket.socket, client_address: object) -> None:  # type: ignore[override]
        """Serve a connection in a thread, or close it if there are too many."""
        if self.count_connections() >= MAX_CONNECTIONS:
            self.shutdown_request(request)
            return
        self._began_s[request] = time.monotonic()
        super().process_request(request, client_address)

    def shutdown_request(self, request: socket.socket) -> None:  # type: ignore[override]
        """End a connection, also one whose thread could not start."""
        self._began_s.pop(request, None)
        super().shutdown_request(request)

    def service_actions(self) -> None:
        """End connections that last too long; called twice a second."""
        oldest_s = time.monotonic() - self.longest_s
        for request, began_s in tuple(self._began_s.items()):
            if began_s < oldest_s:
                with suppress(OSError):
                    request.shutdown(socket.SHUT_RDWR)

    def handle_error(self, request: object, client_address: object) -> None:
        """Ignore what a client does to its connection."""

    def close(self) -> None:
        """Stop listening."""
        if self._thread is not None:
            self.shutdown()
            self._thread.join()
        self.server_close()


class BoundedHttpRequest(BaseHTTPRequestHandler):
    """One request; the connection is closed after it."""

    timeout = IDLE_S
    server_version, sys_version = "zensim", ""

    server: BoundedHttpServer

    def parse_request(self) -> bool:
        """Read the head of the request, and refuse that of a page of another site."""
        if not super().parse_request():
            return False
        hosts, origins = (self.headers.get_all(name) or () for name in ("Host", "Origin"))
        if is_own_origin(hosts, origins, bound_to=self.server.host):
            return True
        self.send_error(HTTPStatus.FORBIDDEN)
        return False

    def log_message(self, format: str, *args: object) -> None:
        """Log nothing: clients decide what would be logged."""

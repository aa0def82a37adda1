"""TcpRelay: passes the bytes of TCP connections on, until it is cut; the connections stay open."""

import socket
import threading
from contextlib import suppress

MAX_BYTES = 65_536


class TcpRelay:
    """Listens on a free port of this host, for connections to another one.

    Attributes:
        port: Where it listens.
    """

    def __init__(self, target_port: int) -> None:
        self._target = ("127.0.0.1", target_port)
        self._is_open = threading.Event()
        self._is_open.set()
        self._sockets: list[socket.socket] = []
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._listener.getsockname()[1])
        threading.Thread(target=self._accept, daemon=True).start()

    def cut(self) -> None:
        """Pass nothing on from now on: what is sent is kept, as by a network that is down."""
        self._is_open.clear()

    def mend(self) -> None:
        """Pass on again, first what was kept."""
        self._is_open.set()

    def reset(self) -> None:
        """End the present connections, with what was kept, and pass later ones on."""
        ended, self._sockets = self._sockets, []
        for one in ended:
            with suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)
            one.close()
        self._is_open.set()

    def close(self) -> None:
        """End all connections."""
        with suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self.reset()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                client, _ = self._listener.accept()
                server = socket.create_connection(self._target)
                self._sockets += [client, server]
                for pair in ((client, server), (server, client)):
                    threading.Thread(target=self._copy, args=pair, daemon=True).start()

    def _copy(self, source: socket.socket, sink: socket.socket) -> None:
        with suppress(OSError):
            while received := source.recv(MAX_BYTES):
                self._is_open.wait()
                sink.sendall(received)
        with suppress(OSError):
            sink.shutdown(socket.SHUT_WR)

"""TcpRelay: passes the bytes of TCP connections on, until it is cut; the connections stay open."""

import socket
import struct
import threading
import time
from contextlib import suppress
from queue import SimpleQueue

MAX_BYTES = 65_536
RESET_AT_ONCE = struct.pack("ii", 1, 0)
Arrival = tuple[float, bytes | None]
"""When it is passed on, and bytes, of which none end the stream; None resets the connection."""


class TcpRelay:
    """Listens on a free port of this host, for connections to another one.

    Attributes:
        port: Where it listens.
    """

    def __init__(self, target_port: int, delay_s: float = 0.0) -> None:
        """Listen.

        Args:
            target_port: Of this host.
            delay_s: Of all bytes and ends, in each direction: half of a round trip.
        """
        self._delay_s = delay_s
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
        arrivals: SimpleQueue[Arrival] = SimpleQueue()
        threading.Thread(target=self._pass_on, args=(arrivals, sink), daemon=True).start()
        received: bytes | None = b"..."
        while received:
            try:
                received = source.recv(MAX_BYTES)
            except OSError:
                received = None
            arrivals.put((time.monotonic() + self._delay_s, received))

    def _pass_on(self, arrivals: "SimpleQueue[Arrival]", sink: socket.socket) -> None:
        pause = threading.Event()
        with suppress(OSError):
            while True:
                due_s, data = arrivals.get()
                pause.wait(max(0.0, due_s - time.monotonic()))
                self._is_open.wait()
                if not data:
                    break
                sink.sendall(data)
            if data is None:
                sink.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET_AT_ONCE)
                sink.close()
            else:
                sink.shutdown(socket.SHUT_WR)

"""Websockets of clients: who may connect, and the loop that sends messages."""

import asyncio
import http
import logging
from collections import deque
from collections.abc import Callable, Collection, Coroutine
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Final

from websockets.asyncio.server import ServerConnection, serve
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.protocol import State
from websockets.typing import Subprotocol

from zensim.foxglove.foxglove_protocol import (
    SUBPROTOCOLS,
    WARNING,
    Status,
    encode_text,
    frame_message,
)
from zensim.foxglove.live_hub import ClientJob, Job, LiveHub
from zensim.proto.web_access import (
    PageAccess,
    has_token_in_address,
    is_own_origin,
    open_listener,
    split_url,
)

TICK_S: Final = 0.02
"""Period at which new messages of topics are sent to clients."""
WATCH_S: Final = 0.1
"""Period at which topics are discovered while no client subscribes."""
IDLE_S: Final = 0.25
"""Period at which the program checks whether it is to end, without clients."""
MAX_MESSAGE_BYTES: Final = 4 << 20
"""Largest message of a client, such as a call with a description to spawn."""
MAX_CLIENTS: Final = 50
MAX_BACKLOG_BYTES: Final = 16 << 20
"""Data that wait for one client; beyond this, messages of topics are left out."""
CAUGHT_UP_BYTES: Final = 1 << 20
"""Backlog at which messages of topics are no longer left out."""
MAX_REPLY_BYTES: Final = 64 << 20
"""Data that wait; beyond this, nothing more is read of the client, and no work of it begins."""
MOST_BACKLOG_BYTES: Final = 256 << 20
"""The same for other messages; beyond this, the link is closed."""
SLOW_NOTICE_S: Final = 1.0
CLOSE_TIMEOUT_S: Final = 1.0
WORKERS, HUB_WORKERS = 4, 3
"""Threads for work of clients, and of the hub."""
MAX_RUNNING_JOBS: Final = 2
"""Work of one client at the same time, so that others get theirs done."""
MAX_WAITING_JOBS: Final = 1000
"""More is refused; a panel requests all meshes of a scene at once."""
MAX_WAITING_BYTES: Final = 16 << 20
TOO_MANY: Final = "too many requests wait; send fewer at the same time"
MAX_ERROR_TEXT: Final = 200

Note = Callable[[str], None]


class NotedErrors(logging.Handler):
    """Notes each error of the websocket library in one line, without a traceback."""

    def __init__(self, note: Note) -> None:
        super().__init__(logging.ERROR)
        self._note = note

    def emit(self, record: logging.LogRecord) -> None:
        """Note an error, such as that of a client that sends no HTTP."""
        cause = record.exc_info[1] if record.exc_info else None
        reason = f": {type(cause).__name__}: {cause}" if cause is not None else ""
        self._note(f"{record.getMessage()}{reason}"[:MAX_ERROR_TEXT])


class ClientJobs:
    """Work of one client that blocks: some at the same time, some that waits, and no more."""

    def __init__(self) -> None:
        self._waiting: deque[ClientJob] = deque()
        self._waiting_bytes = 0
        self._running = 0

    def add(self, job: ClientJob) -> bool:
        """Add work; False if too much waits already."""
        size = self._waiting_bytes + job.size
        if len(self._waiting) >= MAX_WAITING_JOBS or size > MAX_WAITING_BYTES:
            return False
        self._waiting.append(job)
        self._waiting_bytes = size
        return True

    def take(self) -> ClientJob | None:
        """Take the next work that may begin; call `finish` after it."""
        if not self._waiting or self._running >= MAX_RUNNING_JOBS:
            return None
        job = self._waiting.popleft()
        self._waiting_bytes -= job.size
        self._running += 1
        return job

    def finish(self) -> None:
        """Note that work has ended."""
        self._running -= 1

    def clear(self) -> None:
        """Forget what waits."""
        self._waiting.clear()
        self._waiting_bytes = 0


class SocketLink:
    """Link to one client."""

    def __init__(self, connection: ServerConnection) -> None:
        self._connection = connection
        self._transport = connection.transport
        self._is_slow = False
        self.jobs = ClientJobs()
        self.left_out = 0
        """Messages of topics that were left out since the last notice."""

    @property
    def is_full(self) -> bool:
        """Whether the client does not read the replies to what it sends."""
        return self._transport.get_write_buffer_size() > MAX_REPLY_BYTES

    def is_slow(self) -> bool:
        """Whether messages of topics are left out: from too long a backlog until it is short."""
        limit = CAUGHT_UP_BYTES if self._is_slow else MAX_BACKLOG_BYTES
        self._is_slow = self._transport.get_write_buffer_size() > limit
        return self._is_slow

    def send(self, message: str | bytes) -> None:
        """Send a message; close the link if too many bytes wait for the client."""
        if self._transport.get_write_buffer_size() > MOST_BACKLOG_BYTES:
            self._transport.abort()
            return
        self._write(frame_message(message))

    def send_data(self, frames: bytes, messages: int) -> bool:
        """Send whole frames, unless the link is slow."""
        if self.is_slow():
            self.left_out += messages
            return False
        return self._write(frames)

    def _write(self, frames: bytes) -> bool:
        """Write whole frames, unless either side has begun to end the connection."""
        if self._connection.state is not State.OPEN or self._transport.is_closing():
            return False
        try:
            self._transport.write(frames)
        except RuntimeError:  # its sending half was shut, as the client has shut its own
            self._transport.abort()
            return False
        return True

    def take_notice(self) -> None:
        """Send a warning if messages were left out."""
        if self.left_out:
            text = f"{self.left_out} messages were left out: the link is slow"
            self.left_out = 0
            self.send(encode_text(Status(WARNING, text, "slow")))


@dataclass(frozen=True)
class ServedAddress:
    """Address that is served, and which clients may connect.

    Attributes:
        host: An address of this host.
        port: 0 = any free one.
        access: Token and certificate.
        origins: Of other sites whose pages may connect.
    """

    host: str
    port: int
    access: PageAccess
    origins: Collection[str] = ()


class FoxgloveServer:
    """Serves a hub to clients until it is to stop."""

    def __init__(self, hub: LiveHub, address: ServedAddress, note: Note) -> None:
        """Listen.

        Args:
            hub: What is served.
            address: Where to serve, and which clients may connect.
            note: Takes a line about a refused client.

        Raises:
            OSError: The address or the certificate cannot be used.
        """
        self._hub, self._address, self._note = hub, address, note
        self._tls = address.access.make_tls_context()
        self._listener = open_listener(address.host, address.port)
        self.port: int = self._listener.getsockname()[1]
        self._links: set[SocketLink] = set()
        self._tasks: set[asyncio.Task[None]] = set()
        self._workers = ThreadPoolExecutor(WORKERS, "foxglove")
        self._hub_workers = ThreadPoolExecutor(HUB_WORKERS, "foxglove-hub")
        self._logger = logging.Logger("foxglove")
        self._logger.addHandler(NotedErrors(note))
        self._has_joined = asyncio.Event()

    def run(self, should_stop: Callable[[], bool]) -> None:
        """Serve until `should_stop` is true."""
        try:
            asyncio.run(self._serve(should_stop))
        finally:
            self._hub.close()
            self._workers.shutdown(cancel_futures=True)
            self._hub_workers.shutdown(cancel_futures=True)
            self._listener.close()

    async def _serve(self, should_stop: Callable[[], bool]) -> None:
        async with serve(
            self._handle,
            sock=self._listener,
            process_request=self._check,
            subprotocols=[Subprotocol(one) for one in SUBPROTOCOLS],
            compression=None,
            max_size=MAX_MESSAGE_BYTES,
            close_timeout=CLOSE_TIMEOUT_S,
            server_header=None,
            logger=self._logger,
            ssl=self._tls,
        ):
            notice_s = 0.0
            loop = asyncio.get_running_loop()
            while not should_stop():
                await self._wait()
                self._hub.tick()
                for job in self._hub.take_jobs():
                    self._start(self._do_for_hub(job))
                for link in self._links:
                    self._start_waiting(link)
                if loop.time() >= notice_s:
                    notice_s = loop.time() + SLOW_NOTICE_S
                    for link in self._links:
                        link.take_notice()

    async def _wait(self) -> None:
        """Wait for the next turn: a period with clients, else until one connects."""
        if self._hub.has_clients:
            await asyncio.sleep(TICK_S if self._hub.has_subscribers else WATCH_S)
            return
        self._has_joined.clear()
        with suppress(asyncio.TimeoutError):
            await asyncio.wait_for(self._has_joined.wait(), IDLE_S)

    async def _handle(self, connection: ServerConnection) -> None:
        link = SocketLink(connection)
        self._links.add(link)
        self._hub.join(link)
        self._has_joined.set()
        try:
            with suppress(ConnectionClosed):
                async for raw in connection:
                    self._receive(link, raw)
                    while link.is_full:
                        await asyncio.sleep(TICK_S)
        finally:
            self._links.discard(link)
            link.jobs.clear()
            self._hub.leave(link)

    def _receive(self, link: SocketLink, raw: str | bytes) -> None:
        for job in self._hub.receive(link, raw):
            if not link.jobs.add(job):
                link.send(job.fail(TOO_MANY))
        self._start_waiting(link)

    def _start_waiting(self, link: SocketLink) -> None:
        """Begin what may begin of a client's work."""
        while not link.is_full and (job := link.jobs.take()) is not None:
            self._start(self._do_for_client(job, link))

    def _start(self, work: Coroutine[None, None, None]) -> None:
        task = asyncio.ensure_future(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _do_for_client(self, job: ClientJob, link: SocketLink) -> None:
        """Do work of a client in another thread, and send it the outcome."""
        try:
            outcome = await self._do(job, self._workers)
        except Exception as error:  # noqa: BLE001  whatever fails, the client waits for a reply
            outcome = job.fail(self._note_failure(error))
        finally:
            link.jobs.finish()
        if outcome is not None:
            link.send(outcome)
        self._start_waiting(link)

    async def _do_for_hub(self, job: Job) -> None:
        try:
            await self._do(job, self._hub_workers)
        except Exception as error:  # noqa: BLE001  the next job may do
            self._note_failure(error)

    async def _do(self, job: Job, workers: ThreadPoolExecutor) -> str | bytes | None:
        """Do work that blocks in another thread, and then what remains to be done here."""
        outcome = await asyncio.get_running_loop().run_in_executor(workers, job)
        if callable(outcome):
            outcome()
            return None
        return outcome

    def _note_failure(self, error: Exception) -> str:
        text = f"internal error: {type(error).__name__}: {str(error)[:MAX_ERROR_TEXT]}"
        self._note(text)
        return text

    def _check(self, connection: ServerConnection, request: Request) -> Response | None:
        """Refuse clients of other sites, without the token, or of another protocol."""
        hosts, origins = (request.headers.get_all(name) for name in ("Host", "Origin"))
        address = self._address
        respond = partial(self._refuse, connection)
        if not is_own_origin(hosts, origins, bound_to=address.host, admitted=address.origins):
            what = f"origin {', '.join(origins)[:120]!r}, host {', '.join(hosts)[:120]!r}"
            return respond(
                http.HTTPStatus.FORBIDDEN, f"{what} is refused; to admit it use --allow-origin"
            )
        token = address.access.token
        if token and not has_token_in_address(request.path, token):
            path = split_url(request.path).path
            return respond(http.HTTPStatus.UNAUTHORIZED, f"no token in the address {path[:80]!r}")
        if len(self._links) >= MAX_CLIENTS:
            return respond(http.HTTPStatus.SERVICE_UNAVAILABLE, f"{MAX_CLIENTS} clients are served")
        return None

    def _refuse(self, connection: ServerConnection, status: http.HTTPStatus, text: str) -> Response:
        self._note(text)
        return connection.respond(status, f"zensim: {text}\n")

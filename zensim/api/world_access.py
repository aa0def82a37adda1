"""WorldAccess: the few operations on which the API is built; a world in process or on a server."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import msgspec

from zensim.api.api_errors import Error as ApiError
from zensim.api.api_errors import Invalid, NotFound, Timeout, to_api_error
from zensim.api.world_state import WorldState
from zensim.proto.bounded_files import FileTooLarge, NotRegularFile
from zensim.proto.messages.agent_messages import TwistCommands
from zensim.proto.messages.result_messages import ServiceError
from zensim.proto.service_catalog import Request, Response, Service
from zensim.spawner.client.topic_reader import TopicReader

if TYPE_CHECKING:
    from zensim.api.world_recorder import WorldRecorder

Message = TypeVar("Message", bound=msgspec.Struct)


class WorldAccess(ABC):
    """Operations on one world; only `call`, `advance` and `refresh` may take a round trip."""

    world_name = "default"
    """Name of the world, in keys."""
    has_own_clock = True
    """Whether simulation time may advance while the caller does something else."""
    is_eager = False
    """Whether `advance` may return before the agents have published the telemetry of the last step,
    as in a loop of a controller that uses no topics."""

    @abstractmethod
    def call(
        self,
        service: Service[Request, Response],
        request: Request,
        *,
        world: str = "",
        timeout_s: float = 10.0,
        request_id: str = "",
    ) -> Response:
        """Call a service of the catalog; `world` and `request_id` are as in `Bus.call`.

        Raises:
            ServiceError: The request was refused.
            Timeout: There was no reply in time.
            ConnectionLost: The server is gone.
        """

    @abstractmethod
    def advance(self, steps: int, twists: TwistCommands | None, timeout_s: float) -> WorldState:
        """Make steps of a paused world, and return the state after the last.

        Args:
            steps: > 0.
            twists: Orders that count from the first of these steps on: agents revise their answer
                to the present state before it.
            timeout_s: Wall time.

        Raises:
            ServiceError: The steps were refused, canceled or aborted.
            SteppedElsewhere: Another client steps.
            Timeout: The steps were not made in time.
            ConnectionLost: The server is gone.
        """

    @abstractmethod
    def newest(self) -> WorldState:
        """Return the newest state without waiting; after `advance` and `refresh` it is exact.

        Raises:
            ConnectionLost: The server is gone.
        """

    @abstractmethod
    def refresh(self) -> WorldState:
        """Read the present state."""

    @abstractmethod
    def command(self, twists: TwistCommands) -> None:
        """Send orders to a world that runs by itself."""

    @abstractmethod
    def subscribe(self, key: str, kind: type[Message], depth: int) -> TopicReader[Message]:
        """Subscribe to a topic, keeping the newest `depth` messages.

        Raises:
            Unsupported: This world does not publish it.
        """

    @abstractmethod
    def publish(self, key: str, message: msgspec.Struct) -> None:
        """Publish one message on a topic."""

    @abstractmethod
    def wait_until_driven(self, names: Sequence[str], timeout_s: float) -> None:
        """Wait until agents drive these robots.

        Raises:
            Timeout: No agent drives one of them.
        """

    def await_sensor(self, entity: str, sensor: str) -> None:  # noqa: B027  in process: at once
        """Wait until a sensor is measured for its subscribers, so that no step is left out.

        Raises:
            Timeout: The sensor process that is to measure it does not reply.
        """

    def await_subscriber(self, key: str, kind: type[msgspec.Struct]) -> None:  # noqa: B027  likewise
        """Wait until a topic that an agent reads has a subscriber, so that no message is lost."""

    @abstractmethod
    def hold_bond(self) -> str:
        """Return the name of a bond: its entities are deleted when this process ends."""

    @property
    @abstractmethod
    def client(self) -> str:
        """Name of this client, for orders and the lease of stepping."""

    @abstractmethod
    def record(
        self, path: Path, topics: Sequence[str], rate: float, timeout_s: float
    ) -> "WorldRecorder":
        """Record topics; see `Simulation.record`.

        Raises:
            Error: It cannot record.
            Timeout: It has not begun in time.
        """

    @abstractmethod
    def close(self) -> None:
        """Stop what this client commands, and free all."""


@contextmanager
def api_errors() -> Iterator[None]:
    """Convert errors of the lower layers to those of the API."""
    try:
        yield
    except ApiError:
        raise
    except ServiceError as error:
        raise to_api_error(error) from error
    except TimeoutError as error:
        raise Timeout(str(error)) from error
    except FileNotFoundError as error:
        raise NotFound(f"{error.strerror or error}: {error.filename}") from error
    except (IsADirectoryError, PermissionError, FileTooLarge, NotRegularFile) as error:
        fault, _, hint = str(error.strerror).partition("; ")
        slug = getattr(error, "slug", "")
        raise Invalid(f"{error.filename}: {fault}", slug=slug, hint=hint) from error
    except ValueError as error:
        message, _, hint = str(error).partition("; ")
        raise Invalid(message, hint=hint) from error

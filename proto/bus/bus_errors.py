"""Failures of the network."""

from zensim.proto.messages.result_messages import ResultCode


class BusError(Exception):
    """A network operation failed."""


class EndpointUnreachable(BusError):
    """No router or server listens at the endpoints."""


class NoSession(EndpointUnreachable):
    """Something accepts connections at an endpoint to connect to, but opens no session."""


class EndpointTaken(BusError):
    """Another process listens at the endpoint."""


class ForkedProcess(BusError):
    """A process that was forked after a Zenoh session cannot open one: its threads are gone."""

    def __init__(self) -> None:
        super().__init__(
            "this process was forked after a Zenoh session was opened, whose threads it does not "
            "have; use the start method spawn: multiprocessing.set_start_method('spawn')"
        )


class TooFewFiles(BusError):
    """The limit of open files of this process is too low for the sessions of a router."""

    code = ResultCode.OPERATION_FAILED
    slug = "process.files"

    def __init__(self, what: str, needed: int, limit: int) -> None:
        super().__init__(
            f"{self.slug}: {what} needs up to {needed} open files, and a process may have {limit} "
            f"here; raise the limit where it starts: 'ulimit -n {needed}', or LimitNOFILE of its "
            "service"
        )


class NoServer(BusError):
    """No queryable replies on this key."""


class SessionClosed(BusError):
    """This process has closed the session."""


class JoinRefused(BusError):
    """A secured server does not admit the session, or is not the one of the token."""

    def __init__(self, reason: str, message: str) -> None:
        super().__init__(message)
        self.reason = reason
        """One word: see `fetch_authority` and `find_refusal`."""

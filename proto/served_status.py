"""Status of a program by http, whose modules (7 MB) are imported only for an address."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from zensim.proto.program_status import ProgramStatus

if TYPE_CHECKING:
    from zensim.proto.operation_server import OperationServer


@contextmanager
def served_status(address: str, status: ProgramStatus) -> Iterator["OperationServer | None"]:
    """Serve the status of a program while the block runs; nothing if the address is empty.

    Args:
        address: `[HOST:]PORT` of `--metrics`.
        status: Of the program.

    Raises:
        UnusableMetrics: The address cannot be used, or the client library is not installed.
    """
    if not address:
        yield None
        return
    from zensim.proto.operation_server import open_operation_server  # noqa: PLC0415

    server = open_operation_server(address, status)
    try:
        yield server
    finally:
        server.close()

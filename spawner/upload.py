"""Files to the server by content: what it has already is not sent, what it has half goes on."""

from collections.abc import Callable, Sequence

import msgspec

from zensim.proto.messages.asset_messages import MAX_CHUNK_BYTES
from zensim.spawner.assets import AssetFile
from zensim.spawner.client import SimClient

MAX_ATTEMPTS = 3
"""At one place in a file, before silence counts."""


class Outstanding(msgspec.Struct, frozen=True):
    """A file that the server lacks, and how many bytes of its beginning are there."""

    file: AssetFile
    received: int


def outstanding(client: SimClient, files: Sequence[AssetFile]) -> list[Outstanding]:
    """Ask which of these files the server lacks."""
    if not files:
        return []
    answer = client.missing_assets(tuple(file.sha256 for file in files))
    received = answer.received or (0,) * len(answer.missing)
    begun = dict(zip(answer.missing, received, strict=False))
    return [Outstanding(file, begun[file.sha256]) for file in files if file.sha256 in begun]


def send(client: SimClient, lacking: Outstanding, on_bytes: Callable[[int], None]) -> None:
    """Send one file from where the server has it.

    Raises:
        ServiceError: The server refuses it.
        TimeoutError: It does not answer, though asked again.
    """
    offset, attempts = lacking.received, 0
    with lacking.file.path.open("rb") as file:
        while True:
            file.seek(offset)
            try:
                received = client.put_asset(
                    lacking.file.sha256,
                    offset=offset,
                    total=lacking.file.size,
                    data=file.read(MAX_CHUNK_BYTES),
                )
            except TimeoutError:
                received = _received(client, lacking.file)
            attempts = 0 if received > offset else attempts + 1
            if attempts >= MAX_ATTEMPTS:
                raise TimeoutError(f"the server takes no more than {offset} bytes of {file.name}")
            on_bytes(max(0, received - offset))
            offset = received
            if offset >= lacking.file.size:
                return


def _received(client: SimClient, file: AssetFile) -> int:
    still = outstanding(client, [file])
    return still[0].received if still else file.size

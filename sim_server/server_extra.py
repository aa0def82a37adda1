"""The server extra: commands that need its packages say so in one line without them."""

from collections.abc import Iterator
from contextlib import contextmanager

SERVER_EXTRA = ("cryptography", "lxml", "trimesh")


class MissingServerExtra(Exception):
    """The packages of the server extra are not installed."""


@contextmanager
def server_extra() -> Iterator[None]:
    """Report a package of the server extra that is not installed.

    Raises:
        MissingServerExtra: An import inside failed.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        if error.name not in SERVER_EXTRA:
            raise
        raise MissingServerExtra(
            f"{error.name} is not installed; use pip install 'zensim[server]'"
        ) from error

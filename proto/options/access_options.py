"""Options of who may open what a program serves."""

import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from zensim.proto.join_tokens import complete_address, is_join_address
from zensim.proto.web_access import (
    PageAccess,
    add_token_of_file,
    check_certificate,
    check_page_exposure,
    keep_token,
    read_page_token,
    split_token,
    split_url,
)

_access = partial(typer.Option, rich_help_panel="Access")


@dataclass(frozen=True, kw_only=True)
class AccessOptions:
    """Who may open what a program serves."""

    secure: Annotated[
        bool, _access("--secure", metavar="", help="Serve only clients that have the token.")
    ] = False
    insecure: Annotated[
        bool, _access("--insecure", metavar="", help="Serve every client, also of other hosts.")
    ] = False
    certificate: Annotated[
        Path | None, _access("--certificate", metavar="FILE", help="Certificate and chain, PEM.")
    ] = None
    key: Annotated[
        Path | None, _access("--key", metavar="FILE", help="Private key of the certificate, PEM.")
    ] = None
    page_token: Annotated[
        Path | None,
        _access(
            "--page-token",
            metavar="FILE",
            help="File of the token, made if it is missing, so that the address stays the same.",
        ),
    ] = None

    def make_access(self, command: str, host: str, address: str) -> PageAccess:
        """Make the access to what is served.

        Args:
            command: To type, with its verb.
            host: Address to serve.
            address: Of the server; who is served acts as the user of its join token.

        Raises:
            Exposed: It would be open to other hosts, and no option permits it.
            ValueError: Options contradict each other.
            OSError: The file of the token cannot be used.
        """
        check_page_exposure(
            command,
            host,
            has_tls=check_certificate(self.certificate, self.key),
            is_secure=self.secure,
            is_insecure=self.insecure,
        )
        is_joined = is_join_address(complete_address(address)) and not self.insecure
        token = read_page_token(self.page_token) if self.secure or is_joined else ""
        return PageAccess(token, str(self.certificate or ""), str(self.key or ""))

    def write_address(self, what: str, url: str) -> str:
        """Write the address of what is served for people, with its token on a terminal only.

        Elsewhere, as in the log of a service, it names the file that has the token.

        Args:
            what: One word.
            url: With the token, if one is needed.

        Raises:
            OSError: The file of the token cannot be written.
        """
        bare, token = split_token(url)
        if not token or sys.stdout.isatty():
            return f"{what} {url}"
        file = self.page_token or keep_token(token, f"{what}-{split_url(url).port}")
        return f"{what} {add_token_of_file(bare, file)}"

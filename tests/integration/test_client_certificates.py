"""A secured router that asks clients for certificates: who is admitted, and renewal."""

import socket
import ssl
import threading
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import msgspec
import pytest

from tests.integration.processes import eventually, free_endpoint
from zensim.proto import keys
from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_errors import BusError, JoinRefused
from zensim.proto.bus.bus_session import Bus, open_bus
from zensim.proto.join_tokens import KEY_LABEL, JoinToken, read_pem
from zensim.proto.security.roles import User
from zensim.proto.tls_probe import ProbeFailed, fetch_authority
from zensim.sim_server.security import certificates
from zensim.sim_server.security.router_process import secured_router
from zensim.sim_server.security.secure_folder import (
    SecureFolder,
    SecureSettings,
    prepare_secure_folder,
)

WORLD = "default"
WITHIN_S = 20.0
SHORT_S = 3.0
CLOCK = f"sim/{WORLD}/clock"


@dataclass(frozen=True)
class Certified:
    folder: SecureFolder
    server: Bus

    def token(self, user: str) -> JoinToken:
        return self.folder.make_token(self.folder.accounts()[user])


@pytest.fixture(scope="module")
def certified(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Certified]:
    with pytest.MonkeyPatch.context() as patch, ExitStack() as stack:
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        patch.setenv("XDG_CONFIG_HOME", str(tmp_path_factory.mktemp("config")))
        endpoint = free_endpoint("tls")
        folder = prepare_secure_folder(
            SecureSettings(WORLD, None, endpoint, uses_certificates=True)
        )
        folder.ensure(User(name, "agent", (name,)) for name in ("r1", "r2"))
        router = stack.enter_context(secured_router(folder, "test"))
        server = stack.enter_context(open_bus(router.wait()))
        yield Certified(folder, server)


def find_reason(token: JoinToken) -> str:
    try:
        open_bus(BusConfig(connect=(token.write(),))).close()
    except JoinRefused as error:
        return error.reason
    return "admitted"


def with_certificate(token: JoinToken, made: certificates.CertifiedKey) -> JoinToken:
    return msgspec.structs.replace(
        token,
        certificate=ssl.PEM_cert_to_DER_cert(made.certificate.decode()),
        private_key=read_pem(KEY_LABEL, made.private_key.decode()),
    )


def test_reasons_of_refusals_are_told_apart(certified: Certified) -> None:
    token, folder = certified.token("operator"), certified.folder
    own = certificates.CertifiedKey(
        (folder.path / "ca.pem").read_bytes(), (folder.path / "ca.key").read_bytes()
    )
    other = certificates.make_authority(WORLD)
    expired = certificates.make_client_certificate(own, "operator", -60.0)
    foreign = certificates.make_client_certificate(other, "operator", 60.0)

    assert find_reason(token) == "admitted"
    bare = msgspec.structs.replace(token, certificate=b"", private_key=b"")
    assert find_reason(bare) == "certificate_required"
    assert find_reason(with_certificate(token, expired)) == "certificate_expired"
    assert find_reason(with_certificate(token, foreign)) == "certificate_refused"
    assert find_reason(msgspec.structs.replace(token, password=bytes(16))) == "user"


def test_certificate_of_another_user_gives_no_rights(certified: Certified) -> None:
    mine = certificates.CertifiedKey(
        (certified.folder.path / "ca.pem").read_bytes(),
        (certified.folder.path / "ca.key").read_bytes(),
    )
    mixed = with_certificate(
        certified.token("operator"), certificates.make_client_certificate(mine, "r1", 60.0)
    )
    received = certified.server.subscribe("r1/cmd_vel", 16)
    with (
        open_bus(BusConfig(connect=(mixed.write(),))) as wrong,
        open_bus(BusConfig(connect=(certified.token("operator").write(),))) as right,
    ):
        forged, true = wrong.advertise("r1/cmd_vel", ""), right.advertise("r1/cmd_vel", "")

        def arrives() -> bool:
            forged.send(b"forged")
            true.send(b"true")
            found = {sample.payload for sample in received.take()}
            assert b"forged" not in found
            return b"true" in found

        eventually(arrives, WITHIN_S, "a command")
    received.close()


def test_certificate_of_a_client_is_not_one_of_a_server(
    certified: Certified, tmp_path: Path
) -> None:
    token = certified.token("r1")
    (tmp_path / "stolen.pem").write_text(token.certificate_text + certified.folder.authority)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(tmp_path / "stolen.pem")
    with tls_listener(context) as endpoint, pytest.raises(ProbeFailed) as caught:
        fetch_authority(msgspec.structs.replace(token, endpoint=endpoint))

    assert caught.value.reason == "not_signed"


class tls_listener:  # noqa: N801  used as a function
    """A listener that shakes hands, and closes each connection."""

    def __init__(self, context: ssl.SSLContext) -> None:
        self._context = context

    def __enter__(self) -> str:
        self._socket = socket.create_server(("127.0.0.1", 0))
        self._thread = threading.Thread(target=self._answer, daemon=True)
        self._thread.start()
        return f"tls/127.0.0.1:{self._socket.getsockname()[1]}"

    def __exit__(self, *_: object) -> None:
        self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()
        self._thread.join()

    def _answer(self) -> None:
        while True:
            try:
                connection, _ = self._socket.accept()
            except OSError:
                return
            try:
                self._context.wrap_socket(connection, server_side=True).close()
            except OSError:
                connection.close()


def test_renewed_file_keeps_a_session_beyond_the_first_certificate(certified: Certified) -> None:
    account, endpoint = certified.folder.accounts()["r1"], certified.folder.settings.endpoint
    address = certified.folder.write_token(account, endpoint, SHORT_S)
    token = certified.folder.make_token(certified.folder.accounts()["r2"], certificate_s=SHORT_S)
    alive = keys.alive_agent(WORLD, "*")
    mine, other = (keys.alive_agent(WORLD, name) for name in ("r1", "r2"))
    # Watched from before, because a certificate may end before a busy machine looks.
    changes = certified.server.watch_tokens(alive)

    with (
        open_bus(BusConfig(connect=(address,))) as renewed,
        open_bus(BusConfig(connect=(token.write(),))) as left,
    ):
        tokens = renewed.token(mine), left.token(other)
        seen: set[tuple[str, bool]] = set()

        def has_seen(*, is_alive: bool) -> bool:
            seen.update(changes.take())
            return seen >= {(mine, is_alive), (other, is_alive)}

        eventually(lambda: has_seen(is_alive=True), WITHIN_S, "both sessions")
        certified.folder.write_token(account, endpoint)
        eventually(lambda: has_seen(is_alive=False), WITHIN_S, "the end of the certificates")
        eventually(
            lambda: certified.server.list_tokens(alive) == [mine], WITHIN_S, "the renewed session"
        )
        for one in tokens:
            one.close()
        changes.close()


def test_long_token_is_refused_after_revocation(certified: Certified) -> None:
    token = certified.token("recorder")
    certified.folder.revoke("recorder")

    eventually(lambda: is_revoked(token), WITHIN_S, "the refusal")


def is_revoked(token: JoinToken) -> bool:
    try:
        return find_reason(token) == "revoked"
    except BusError:
        # The router opens again.
        return False

"""The folder of a secured server: authority, router certificate, users and their passwords.

The folder has mode 0700 and its files 0600; each file is replaced as a whole.
"""

import errno
import hashlib
import os
import socket
import time
from collections.abc import Iterable, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Final

import msgspec

from zensim.proto.bounded_files import MAX_OWN_FILE_BYTES, read_file
from zensim.proto.bus.bus_config import BusConfig, Credentials, RouterSecurity
from zensim.proto.endpoints import ENDPOINT_PATTERN, check_endpoint
from zensim.proto.join_tokens import (
    CERTIFICATE_LABEL,
    DEFAULT_WORLD,
    KEY_LABEL,
    JoinToken,
    decode_base64,
    encode_base64,
    hash_revoked_password,
    make_password,
    read_pem,
)
from zensim.proto.names import check_name
from zensim.proto.process_limits import lock_file
from zensim.proto.security.access_rules import make_access_rules
from zensim.proto.security.roles import ROLES, SERVER_USER, RefusedUser, User, check_user
from zensim.proto.whole_files import writing_whole

if TYPE_CHECKING:
    from collections.abc import Iterator

    from zensim.sim_server.security.certificates import CertifiedKey

FIRST_USERS: Final = tuple(name for name, role in ROLES.items() if not role.has_robots)
"""Users that a new folder has, each named as its role; agents need the names of their robots."""
DEFAULT_SECURE_ENDPOINT: Final = "tls/127.0.0.1:7447"
ANY_ADDRESSES: Final = frozenset({"0.0.0.0", "[::]"})
CERTIFICATE_S: Final = 86_400.0
"""How long the client certificate of a token is valid, from when it is printed."""
LOCAL_CERTIFICATE_S: Final = 3650 * 86_400.0
"""Validity of certificates of programs on this host, which lie beside the key of the authority."""
MAX_REVOKED: Final = 200
"""Newest revoked passwords whose owners are told so; it bounds the router's certificate."""
LOCK_TIMEOUT_S, LOCK_POLL_S = 5.0, 0.01
ADMISSION_TIMEOUT_S: Final = 10.0
"""Time for a router to open again, and for its server to be linked to it."""
PUBLIC_TEST_ADDRESS: Final = ("192.0.2.1", 9)
"""Address of a network for documentation: it gives the address of the route, and sends nothing."""


class CertificateNote(msgspec.Struct, frozen=True):
    """What the certificate of the router says: a later start need not parse it, nor import that."""

    certificate_hash: str
    revoked_hash: str
    """Hash of the digests of revoked passwords that it lists."""
    renewal_s: float
    """Seconds since the epoch."""


class MissingFolder(ValueError):
    """There is no secured server of this world on this host."""


class FolderInUse(ValueError):
    """Another server of this world runs on this host."""


class Account(msgspec.Struct, frozen=True):
    """A user, and how it proves who it is."""

    user: User
    password: str
    """128 random bits in base64url."""
    expires_s: float = 0.0
    """Seconds since the epoch; 0 = never."""

    def __repr__(self) -> str:
        """Name the user only."""
        return f"Account({self.user.name!r})"

    def is_active(self, now_s: float) -> bool:
        """Whether the account has not expired."""
        return not self.expires_s or now_s < self.expires_s


class SecureSettings(msgspec.Struct, frozen=True):
    """What router and tokens need to know of the server."""

    world: str = DEFAULT_WORLD
    domain: int | None = 0
    """Domain of ROS 2; None = no keys of ROS 2."""
    endpoint: str = DEFAULT_SECURE_ENDPOINT
    """Endpoint that the router listens on."""
    uses_certificates: bool = False
    """Whether clients need a certificate beside their password."""


def find_secure_folder(world: str) -> Path:
    """Find the folder of a world, which may not exist, below XDG_STATE_HOME."""
    state = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    return Path(state) / "zensim" / check_name(world, "world")


class SecureFolder:
    """Files of one secured server."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._read_state: tuple[int, int] | None = None
        self._accounts: dict[str, Account] = {}

    def _read(self, name: str) -> bytes:
        return read_file(self.path / name, MAX_OWN_FILE_BYTES)

    @property
    def authority(self) -> str:
        """Certificate of the authority, PEM."""
        return self._read("ca.pem").decode("ascii")

    @property
    def settings(self) -> SecureSettings:
        """Settings of the server that ran last."""
        return msgspec.json.decode(self._read("settings.json"), type=SecureSettings)

    def prepare(self, settings: SecureSettings) -> None:
        """Make what the folder lacks, and replace its settings."""
        if not (self.path / "ca.pem").is_file():
            from zensim.sim_server.security import certificates  # noqa: PLC0415  needs an extra

            made = certificates.make_authority(settings.world)
            self._write("ca.key", made.private_key)
            self._write("ca.pem", made.certificate)
        if not (self.path / "server.password").is_file():
            self._write("server.password", encode_base64(make_password()).encode())
        self.write_settings(settings)
        if not (self.path / "users.json").is_file():
            self._write_accounts(())
            self.add(User(name, name) for name in FIRST_USERS)
        self._ensure_router_certificate()

    def write_settings(self, settings: SecureSettings) -> None:
        """Replace the settings."""
        self._write("settings.json", msgspec.json.encode(settings))

    def accounts(self) -> Mapping[str, Account]:
        """Read all accounts by name, if the file has changed."""
        status = (self.path / "users.json").stat()
        if (state := (status.st_mtime_ns, status.st_ino)) != self._read_state:
            data = self._read("users.json")
            accounts = msgspec.json.decode(data, type=list[Account])
            self._accounts = {account.user.name: account for account in accounts}
            self._read_state = state
        return self._accounts

    def find_user(self, name: str) -> User | None:
        """Find an active user."""
        account = self.accounts().get(name)
        return account.user if account and account.is_active(time.time()) else None

    def list_active(self) -> list[Account]:
        """List the accounts that have not expired."""
        now_s = time.time()
        return [account for account in self.accounts().values() if account.is_active(now_s)]

    def add(self, users: Iterable[User], ttl_s: float = 0.0) -> list[Account]:
        """Add accounts with new passwords.

        Raises:
            RefusedUser: A user cannot exist, or its name is taken.
        """
        added = [
            Account(
                check_user(user),
                encode_base64(make_password()),
                time.time() + ttl_s if ttl_s else 0.0,
            )
            for user in users
        ]
        with self._changing():
            accounts = dict(self.accounts())
            for account in added:
                if (former := accounts.get(account.user.name)) and former.is_active(time.time()):
                    raise RefusedUser(
                        f"user '{account.user.name}' exists; choose another `name`, or revoke it"
                    )
                if former:
                    self._note_revoked(former)
                accounts[account.user.name] = account
            self._write_accounts(accounts.values())
        return added

    def ensure(self, users: Iterable[User]) -> list[Account]:
        """Return the accounts of users; those that do not exist as such are made."""
        wanted = tuple(users)
        for user in wanted:
            former = self.accounts().get(user.name)
            if former and (former.user != user or not former.is_active(time.time())):
                self.revoke(user.name)
        self.add(user for user in wanted if user.name not in self.accounts())
        return [self.accounts()[user.name] for user in wanted]

    def revoke(self, name: str) -> None:
        """Remove an account.

        Raises:
            RefusedUser: There is none.
        """
        with self._changing():
            accounts = dict(self.accounts())
            if (former := accounts.pop(name, None)) is None:
                raise RefusedUser(
                    f"user {name[:64]!r} does not exist; 'zensim token list' lists all"
                )
            self._note_revoked(former)
            self._write_accounts(accounts.values())

    def list_revoked(self) -> tuple[bytes, ...]:
        """List digests of revoked and expired passwords, oldest first."""
        path = self.path / "revoked"
        lines = self._read("revoked").decode("ascii").split() if path.is_file() else []
        now_s = time.time()
        expired = [one for one in self.accounts().values() if not one.is_active(now_s)]
        digests = [bytes.fromhex(line) for line in lines] + [_hash_password(one) for one in expired]
        return tuple(digests[-MAX_REVOKED:])

    def make_token(
        self, account: Account, host: str = "", certificate_s: float = CERTIFICATE_S
    ) -> JoinToken:
        """Make the join token of an account, with a new certificate where clients need one.

        Args:
            account: One of this folder.
            host: Name or address for clients; empty = as the router listens.
            certificate_s: Validity of the certificate, which also ends with the account.
        """
        settings = self.settings
        der = read_pem(CERTIFICATE_LABEL, self.authority)
        token = JoinToken(
            make_public_endpoint(settings.endpoint, host),
            account.user.name,
            decode_base64(account.password),
            hashlib.sha256(der).digest(),
            settings.world,
        )
        if not settings.uses_certificates:
            return token
        if account.expires_s:
            certificate_s = min(certificate_s, account.expires_s - time.time())
        made = self._make_client_certificate(account.user.name, certificate_s).decode()
        return msgspec.structs.replace(
            token,
            certificate=read_pem(CERTIFICATE_LABEL, made),
            private_key=read_pem(KEY_LABEL, made),
        )

    def write_token(
        self, account: Account, endpoint: str, certificate_s: float = LOCAL_CERTIFICATE_S
    ) -> str:
        """Write a token for a program on this host to a file; return its join address."""
        token = self.make_token(account, certificate_s=certificate_s)
        name = f"{account.user.name}.token"
        content = msgspec.structs.replace(token, endpoint=endpoint).write_file()
        self._write(name, content.encode())
        return f"@{self.path / name}"

    def write_all_tokens(self) -> str:
        """Write the join tokens as JSON, by user, to a file of mode 600; return its path."""
        tokens = {one.user.name: self.make_token(one).write() for one in self.list_active()}
        self._write("tokens.json", msgspec.json.encode(tokens))
        return str(self.path / "tokens.json")

    def note_first_display(self) -> bool:
        """Note that the tokens are displayed; whether that is the first time."""
        try:
            (self.path / "displayed").touch(mode=0o600, exist_ok=False)
        except FileExistsError:
            return False
        return True

    def make_router_config(self, endpoint: str) -> BusConfig:
        """Configure the router for the accounts that are active now."""
        accounts = self.list_active()
        settings = self.settings
        lines = [f"{account.user.name}:{account.password}\n" for account in accounts]
        lines.append(f"{SERVER_USER}:{self._server_password()}\n")
        self._write("passwords", "".join(lines).encode())
        rules = make_access_rules(
            (account.user for account in accounts),
            world=settings.world,
            domain=settings.domain,
            uses_certificates=settings.uses_certificates,
        )
        self._ensure_router_certificate()
        security = RouterSecurity(
            certificate=str(self.path / "router.pem"),
            private_key=str(self.path / "router.key"),
            passwords=str(self.path / "passwords"),
            client_authority=str(self.path / "ca.pem") if settings.uses_certificates else "",
            access_control=rules,
        )
        return BusConfig(mode="router", listen=(endpoint,), router_security=security)

    def make_server_config(self, endpoint: str) -> BusConfig:
        """Configure the session of the server, a client of its router on this host."""
        certificate = ""
        if self.settings.uses_certificates:
            made = self._make_client_certificate(SERVER_USER, LOCAL_CERTIFICATE_S)
            certificate = made.decode()
        credentials = Credentials(
            user=SERVER_USER,
            password=self._server_password(),
            authority=self.authority,
            certificate=certificate,
        )
        return BusConfig(connect=(endpoint,), credentials=credentials)

    def _make_client_certificate(self, user: str, valid_s: float) -> bytes:
        """Make certificate and private key of a user, PEM."""
        from zensim.sim_server.security import certificates  # noqa: PLC0415  needs an extra

        made = certificates.make_client_certificate(self._read_authority(), user, valid_s)
        return made.certificate + made.private_key

    def _ensure_router_certificate(self) -> None:
        """Make the certificate of the router, unless it is valid and lists the revoked."""
        router, revoked = self.path / "router.pem", self.list_revoked()
        if self._is_noted(revoked):
            return
        from zensim.sim_server.security import certificates  # noqa: PLC0415  needs an extra

        former = self._read("router.pem") if router.is_file() else b""
        if (
            not former
            or certificates.find_renewal_s(former) <= time.time()
            or not certificates.has_revoked(former, revoked)
        ):
            own = certificates.make_router_certificate(self._read_authority(), revoked=revoked)
            self._write("router.key", own.private_key)
            self._write("router.pem", own.certificate)
            former = own.certificate
        renewal_s = certificates.find_renewal_s(former)
        note = CertificateNote(_hash(former), _hash(b"".join(revoked)), renewal_s)
        self._write("router.json", msgspec.json.encode(note))

    def _is_noted(self, revoked: Iterable[bytes]) -> bool:
        """Whether this very certificate was found to list the revoked, and is not due."""
        try:
            note = msgspec.json.decode(self._read("router.json"), type=CertificateNote)
            found = _hash(self._read("router.pem")), _hash(b"".join(revoked))
        except (FileNotFoundError, msgspec.DecodeError):
            return False
        is_same = found == (note.certificate_hash, note.revoked_hash)
        return is_same and time.time() < note.renewal_s

    def _read_authority(self) -> "CertifiedKey":
        from zensim.sim_server.security import certificates  # noqa: PLC0415  needs an extra

        return certificates.CertifiedKey(self._read("ca.pem"), self._read("ca.key"))

    def _note_revoked(self, account: Account) -> None:
        path = self.path / "revoked"
        former = self._read("revoked").decode("ascii").split() if path.is_file() else []
        lines = [*former, _hash_password(account).hex()][-MAX_REVOKED:]
        self._write("revoked", "\n".join(lines).encode())

    def _server_password(self) -> str:
        return self._read("server.password").decode("ascii")

    def _write_accounts(self, accounts: Iterable[Account]) -> None:
        self._write("users.json", msgspec.json.format(msgspec.json.encode(list(accounts))))

    def _write(self, name: str, data: bytes) -> None:
        if _is_private_copy(self.path / name, data):
            return
        with writing_whole(self.path / name, mode=0o600) as stream:
            stream.write(data)

    @contextmanager
    def routing(self, timeout_s: float = LOCK_TIMEOUT_S) -> "Iterator[None]":
        """Be the router of this folder meanwhile: who changes its users waits for it.

        Raises:
            FolderInUse: Another process is its router.
        """
        with ExitStack() as stack:
            try:
                stack.enter_context(self._locked("router.lock", timeout_s))
            except BlockingIOError as error:
                raise FolderInUse(
                    f"world '{self.settings.world}' already has a secured server on this host; "
                    "stop it, or use `world_name` with another"
                ) from error
            yield

    def note_admitted(self, accounts: Iterable[Account]) -> None:
        """Note whom the router admits, for `wait_until_admitted`; its server is linked to it."""
        self._write("admitted", _hash_accounts(accounts).encode())

    def forget_admitted(self) -> None:
        """Note that the router is about to change whom it admits."""
        (self.path / "admitted").unlink(missing_ok=True)

    def wait_until_admitted(self, timeout_s: float = ADMISSION_TIMEOUT_S) -> bool:
        """Wait until the router, if it runs, admits just the active users; return whether so."""
        deadline_s = time.monotonic() + timeout_s
        while self._is_routed() and not self._is_admitted():
            if time.monotonic() > deadline_s:
                return False
            time.sleep(LOCK_POLL_S)
        return True

    def _is_admitted(self) -> bool:
        with suppress(FileNotFoundError):
            noted = self._read("admitted").decode("ascii")
            return noted == _hash_accounts(self.list_active())
        return False

    def _is_routed(self) -> bool:
        try:
            with self._locked("router.lock", timeout_s=0.0):
                return False
        except BlockingIOError:
            return True

    def _changing(self) -> AbstractContextManager[None]:
        """Let no other process change the users meanwhile."""
        return self._locked("lock")

    @contextmanager
    def _locked(self, name: str, timeout_s: float = LOCK_TIMEOUT_S) -> "Iterator[None]":
        """Hold the lock of a file.

        Raises:
            BlockingIOError: Another process holds it until the timeout.
        """
        descriptor = os.open(self.path / name, os.O_RDWR | os.O_CREAT, 0o600)
        try:
            _lock(descriptor, time.monotonic() + timeout_s)
            yield
        finally:
            os.close(descriptor)


def _lock(descriptor: int, deadline_s: float) -> None:
    while True:
        try:
            lock_file(descriptor)
        except OSError as error:
            if time.monotonic() >= deadline_s:
                raise BlockingIOError(
                    errno.EWOULDBLOCK, "another process holds the lock"
                ) from error
        else:
            return
        time.sleep(LOCK_POLL_S)


def open_secure_folder(world: str) -> SecureFolder:
    """Open the folder of a world.

    Raises:
        MissingFolder: There is none.
    """
    path = find_secure_folder(world)
    if not (path / "users.json").is_file():
        raise MissingFolder(
            f"world '{world}' has no secured server on this host ({path} does not exist); start "
            "one with 'zensim serve --secure'"
        )
    return SecureFolder(path)


def prepare_secure_folder(settings: SecureSettings) -> SecureFolder:
    """Open the folder of a world, with settings; what it lacks is made.

    Raises:
        PermissionError: The folder belongs to another user.
        FolderInUse: See there.
    """
    path = find_secure_folder(settings.world)
    path.mkdir(mode=0o700, parents=True, exist_ok=True)
    path.chmod(0o700)
    folder = SecureFolder(path)
    # The endpoint of a running server stays in its tokens.
    with folder.routing():
        folder.prepare(settings)
    return folder


def _hash(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _hash_accounts(accounts: Iterable[Account]) -> str:
    """Hash whom a router admits; passwords have 128 random bits."""
    ordered = sorted(accounts, key=lambda account: account.user.name)
    return _hash(msgspec.json.encode(ordered))


def _is_private_copy(path: Path, data: bytes) -> bool:
    """Whether a file has this content, and is for its owner only."""
    try:
        return path.stat().st_mode & 0o077 == 0 and read_file(path, MAX_OWN_FILE_BYTES) == data
    except FileNotFoundError:
        return False


def _hash_password(account: Account) -> bytes:
    return hash_revoked_password(decode_base64(account.password))


def to_secure_endpoint(endpoint: str) -> str:
    """Make the TLS endpoint to listen on from the one asked for.

    Raises:
        ValueError: It is neither TCP nor TLS.
    """
    protocol, _, address = check_endpoint(endpoint).partition("/")
    if protocol not in ("tcp", "tls"):
        raise ValueError(f"`secure` needs a TLS endpoint, got {endpoint!r}; use tls/{address}")
    return f"tls/{address}"


def make_public_endpoint(endpoint: str, host: str = "") -> str:
    """Make the endpoint that clients on other hosts connect to.

    Args:
        endpoint: That the router listens on.
        host: Name or address for clients; empty = as the router listens, and for all addresses
            the one of this host's default route.
    """
    match = ENDPOINT_PATTERN.fullmatch(check_endpoint(endpoint))
    if match is None or not (host or match["host"] in ANY_ADDRESSES):
        return endpoint
    return f"tls/{host or _find_own_address()}:{match['port']}"


def _find_own_address() -> str:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(PUBLIC_TEST_ADDRESS)
        except OSError:
            return socket.gethostname()
        return str(probe.getsockname()[0])

"""Builds of the peers and of zenohd, kept in a cache.

The cache is `INTEROP_CACHE`, or zensim/interop in the user's cache. A build is found again by the
contents of the sources and message files.
"""

import hashlib
import os
import shutil
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path

from tests.interop.interface_files import write_interface_files

SOURCES = Path(__file__).with_name("peers")
CACHE_VARIABLE = "INTEROP_CACHE"
BINARY = "interop-peers"
ROUTER_VERSION = "1.9.0"
"""The version of Zenoh in hiroz 0.2.0."""
BUILD_S = 3600.0
SHORT_BUILD_S = 900.0
"""Longest build in a short run; what was compiled is kept for the next."""
KEY_DIGITS = 16
PROFILE = {"CARGO_PROFILE_RELEASE_OPT_LEVEL": "0", "CARGO_PROFILE_RELEASE_DEBUG": "0"}
"""Builds zenohd in a third of the time; the peers name the same in their Cargo.toml."""

NO_MORE: Mapping[str, str] = {}


class PeersMissing(Exception):
    """There are no peers, and none can be built here."""


def find_cargo() -> str:
    """Find cargo on the PATH, or where rustup puts it.

    Raises:
        PeersMissing: There is none.
    """
    installed = Path.home() / ".cargo" / "bin" / "cargo"
    found = shutil.which("cargo") or (str(installed) if installed.is_file() else None)
    if found is None:
        raise PeersMissing("no cargo here")
    return found


def cache_folder() -> Path:
    """Find the folder of builds."""
    if chosen := os.environ.get(CACHE_VARIABLE):
        return Path(chosen)
    users = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(users) / "zensim" / "interop"


def build_peers(distro: str, *, within_s: float = BUILD_S) -> Path:
    """Build the peers of a distribution, `jazzy` or `humble`, unless the cache has them.

    Raises:
        PeersMissing: There is no cargo, or the build fails.
    """
    built = find_peers(distro)
    if not built.is_file():
        cargo, folder = find_cargo(), cache_folder()
        features = ("--no-default-features", "--features", distro)
        target = folder / "target"
        # Cargo recognizes a package by its path.
        package = folder / "package"
        shutil.rmtree(package, ignore_errors=True)
        write_package(package)
        build = (cargo, "build", "--release", *features, "--target-dir", str(target))
        run_build(build, package, within_s)
        keep_program(target / "release" / BINARY, built)
    return built


def find_peers(distro: str) -> Path:
    """Find the place of a build of these sources."""
    return cache_folder() / f"{BINARY}-{distro}-{_own_key()}"


@cache
def _own_key() -> str:
    with tempfile.TemporaryDirectory() as scratch:
        write_package(Path(scratch))
        return key_of(Path(scratch))


def write_package(folder: Path) -> None:
    """Copy the sources, and write the message files beside them."""
    shutil.copytree(SOURCES, folder, dirs_exist_ok=True)
    write_interface_files(folder / "interfaces")


def build_router(*, within_s: float = BUILD_S) -> Path:
    """Build zenohd, unless the cache has it.

    Raises:
        PeersMissing: There is no cargo, or the build fails.
    """
    cargo, folder = find_cargo(), cache_folder()
    built = _router_path()
    if not built.is_file():
        folder.mkdir(parents=True, exist_ok=True)
        target = folder / "target-zenohd"
        wanted = (
            "install",
            "zenohd",
            "--version",
            ROUTER_VERSION,
            "--locked",
            "--no-track",
            "--force",
        )
        places = ("--root", str(folder / "zenohd"), "--target-dir", str(target))
        run_build((cargo, *wanted, *places), folder, within_s)
        keep_program(folder / "zenohd" / "bin" / "zenohd", built)
    return built


def has_router() -> bool:
    """Whether the cache has zenohd."""
    return _router_path().is_file()


def _router_path() -> Path:
    return cache_folder() / f"zenohd-{ROUTER_VERSION}"


def key_of(folder: Path) -> str:
    """Hash the names and contents of all files under a folder."""
    whole = hashlib.sha256()
    for path in sorted(one for one in folder.rglob("*") if one.is_file()):
        name = path.relative_to(folder).as_posix()
        content = hashlib.sha256(path.read_bytes()).hexdigest()
        whole.update(f"{name} {content}\n".encode())
    return whole.hexdigest()[:KEY_DIGITS]


def run_build(
    command: Sequence[str], folder: Path, within_s: float, variables: Mapping[str, str] = NO_MORE
) -> None:
    """Run cargo, or another program that builds.

    Raises:
        PeersMissing: It fails, or takes too long.
    """
    try:
        done = subprocess.run(
            ["nice", *command],
            env={**os.environ, **PROFILE, **variables},
            cwd=folder,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            timeout=within_s,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        what = "the build of the peers is not complete"
        raise PeersMissing(f"{what} after {within_s:g} s; the next run goes on") from error
    if done.returncode:
        errors = [line for line in done.stderr.splitlines() if line.startswith("error")]
        raise PeersMissing(
            f"{Path(command[0]).name} fails: {'; '.join(errors) or done.stderr[-500:]}"
        )


def keep_program(made: Path, built: Path) -> None:
    """Move a program to its place in one step, because others may look for it."""
    partial = built.with_name(f"{built.name}.{os.getpid()}")
    shutil.copy2(made, partial)
    partial.replace(built)

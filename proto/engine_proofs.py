"""Proofs of engines in the user's cache folder: which build of an engine passed which cases."""

import os
from collections.abc import Iterable, Iterator
from contextlib import suppress
from hashlib import sha256
from importlib.util import find_spec
from pathlib import Path
from typing import Final, Literal

import msgspec

from zensim.proto.bounded_files import MAX_OWN_FILE_BYTES, read_file
from zensim.proto.package_versions import find_package_version
from zensim.proto.whole_files import writing_whole

EngineName = Literal["pybullet", "mujoco"]
LIBRARY_MARKS: Final = (".so", ".dylib", ".pyd", ".dll")
"""Parts of the names of shared libraries; some systems write the version after them."""
CASES_FOLDER: Final = (
    Path(__file__).resolve().parent.parent / "sim_server" / "physics" / "engine_proof"
)
"""Folder of the cases; a proof is one of these cases, so that others make it invalid."""
DIGEST_LENGTH: Final = 16


class EngineBuild(msgspec.Struct, frozen=True):
    """What an engine's name stands for on this host."""

    engine: EngineName
    version: str
    """Version of the package of the engine."""
    digest: str
    """Hash of the names, sizes and dates of its shared libraries, and of the cases of the proof."""


class CaseResult(msgspec.Struct, frozen=True):
    """Result of one case."""

    case: str
    what: str
    """Quantity that is compared, with its unit."""
    seen: float | None
    """None = the engine raised an error, or the number is not finite."""
    expected: float
    tolerance: float
    fault: str = ""
    """The error that it raised."""

    @property
    def is_passed(self) -> bool:
        """Whether what was seen is what is expected."""
        return self.seen is not None and abs(self.seen - self.expected) <= self.tolerance

    def describe(self) -> str:
        """Write what was seen, and what is right, as part of a line."""
        if self.fault:
            return f"{self.case}: {self.fault}"
        seen = "not a number" if self.seen is None else f"{self.seen:.4g}"
        right = f"{self.expected:.4g} within {self.tolerance:.2g} is right"
        return f"{self.case}: {self.what} is {seen}, {right}"


class EngineProof(msgspec.Struct, frozen=True):
    """Results of all cases on one build of an engine."""

    build: EngineBuild
    cases: tuple[CaseResult, ...]
    proved_at_s: float
    """Wall time since the epoch."""

    @property
    def failed(self) -> CaseResult | None:
        """The first case that failed."""
        return next((one for one in self.cases if not one.is_passed), None)


def find_engine_build(engine: EngineName) -> EngineBuild:
    """Find the installed build of an engine, without importing it."""
    version = find_package_version(engine) or "of unknown version"
    files = [*_list_libraries(engine), *CASES_FOLDER.glob("*.py")]
    facts = [(file.name, *_read_size_and_date(file)) for file in sorted(files)]
    digest = sha256(repr((engine, version, facts)).encode()).hexdigest()
    return EngineBuild(engine, version, digest[:DIGEST_LENGTH])


def _list_libraries(module: str) -> Iterator[Path]:
    """List the shared libraries of a module: itself, or those of its folder."""
    spec = find_spec(module)
    if spec is None:
        return
    if not spec.submodule_search_locations:
        yield Path(spec.origin or "")
        return
    for folder in map(Path, spec.submodule_search_locations):
        for file in folder.iterdir():
            if any(mark in file.name for mark in LIBRARY_MARKS):
                yield file


def _read_size_and_date(file: Path) -> tuple[int, int]:
    status = file.stat()
    # Layers of container images keep whole seconds.
    return status.st_size, int(status.st_mtime)


def find_proofs_folder() -> Path:
    """Find the folder of the proofs; it need not exist.

    Raises:
        RuntimeError: The user has no home folder.
    """
    caches = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(caches) / "zensim" / "engine_proofs"


def read_proof(build: EngineBuild) -> EngineProof | None:
    """Read the proof of a build; None if there is no valid one."""
    with suppress(OSError, RuntimeError, msgspec.DecodeError):
        proof = msgspec.json.decode(
            read_file(_find_file(build), MAX_OWN_FILE_BYTES), type=EngineProof
        )
        if proof.build == build:
            return proof
    return None


def write_proof(proof: EngineProof) -> None:
    """Keep a proof; processes may write the same one.

    Raises:
        OSError: It cannot be written.
        RuntimeError: The user has no home folder.
    """
    file = _find_file(proof.build)
    file.parent.mkdir(parents=True, exist_ok=True)
    with writing_whole(file) as stream:
        stream.write(msgspec.json.encode(proof))


def _find_file(build: EngineBuild) -> Path:
    words: Iterable[str] = (build.engine, build.version.replace("/", "_"), build.digest)
    return find_proofs_folder() / f"{'-'.join(words)}.json"

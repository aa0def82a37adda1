"""What `zensim doctor` reports of its own host: Python, packages, engines and their proofs."""

import platform
import sys
import time
from collections.abc import Iterator
from importlib.util import find_spec
from typing import get_args

from zensim.deploy.cli.findings import Finding
from zensim.proto.engine_proofs import EngineName, find_engine_build, find_proofs_folder, read_proof
from zensim.proto.exit_codes import ExitCode
from zensim.proto.package_versions import find_reported_versions

AGES = ((86_400.0, "days"), (3600.0, "hours"), (60.0, "minutes"))


def describe_host() -> Iterator[Finding]:
    """Describe what a server or a world on this host would use."""
    system = f"{sys.platform} {platform.machine()}"
    yield Finding("ok", "python", f"{platform.python_version()} on {system}, {sys.executable}")
    versions = find_reported_versions().items()
    yield Finding("ok", "packages", ", ".join(f"{name} {found}" for name, found in versions))
    for engine in get_args(EngineName):
        if find_spec(engine) is not None:
            yield _check_engine(engine)
    yield _find_cache()


def _check_engine(engine: EngineName) -> Finding:
    build = find_engine_build(engine)
    named = f"{engine} {build.version}"
    proof = read_proof(build)
    if proof is None:
        advice = "the first world with it takes a second to prove it"
        return Finding("note", "engine", f"{named} has not proved itself here yet", advice)
    age = format_age(time.time() - proof.proved_at_s)
    if proof.failed is None:
        found = f"{named} passed {len(proof.cases)} cases {age} ago"
        return Finding("ok", "engine", found)
    return Finding(
        "wrong",
        "engine",
        f"{named} failed a case {age} ago: {proof.failed.describe()}",
        "install another version of it, or use the other engine (docs/upgrade.md)",
        ExitCode.FAILED,
    )


def _find_cache() -> Finding:
    try:
        return Finding("ok", "cache", f"proofs of engines are kept in {find_proofs_folder()}")
    except RuntimeError:
        advice = "set XDG_CACHE_HOME, else each start proves its engine"
        return Finding("note", "cache", "the user has no home folder for a cache", advice)


def format_age(seconds: float) -> str:
    """Write an age in its greatest whole unit."""
    for length, unit in AGES:
        if seconds >= 2 * length:
            return f"{seconds / length:.0f} {unit}"
    return f"{max(0.0, seconds):.0f} seconds"

"""rclpy from wheels, and a bridge between DDS and Zenoh: kept in the cache of the peers.

The wheels are of PyPI, pinned by hashes; tf2_msgs, which has none, is generated. The bridge
is zenoh-plugin-ros2dds, linked into a router.
"""

import hashlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

from tests.interop.peer_build import (
    BUILD_S,
    SHORT_BUILD_S,
    PeersMissing,
    cache_folder,
    find_cargo,
    keep_program,
    key_of,
    run_build,
)

SOURCES = Path(__file__).with_name("bridge")
REQUIREMENTS = Path(__file__).with_name("ros_requirements.txt")
MESSAGES = Path(__file__).with_name("ros_programs") / "make_messages.py"
BINARY = "interop-bridge"
PYTHON = "python3.11"
"""The wheels are of CPython 3.11."""
PLUGIN_VERSION = "1.10.2"


def find_bridge() -> Path:
    """Find the place of a build of the bridge."""
    return cache_folder() / f"{BINARY}-{key_of(SOURCES)}"


def find_ros_python() -> Path:
    """Find the place of the interpreter that has rclpy."""
    both = REQUIREMENTS.read_bytes() + MESSAGES.read_bytes()
    digest = hashlib.sha256(both).hexdigest()[:16]
    return cache_folder() / f"ros-{digest}" / "bin" / "python"


def check_ros_cache() -> None:
    """Check that rclpy and the bridge were built.

    Raises:
        PeersMissing: They were not.
    """
    for path in (find_ros_python(), find_bridge()):
        if not path.exists():
            raise PeersMissing(f"no {path}, which python -m tests.interop rclpy --build makes")


def prepare_ros(*, is_short: bool) -> None:
    """Build what is missing; with `INTEROP=cached` only check that it was built.

    Raises:
        PeersMissing: It was not built, or cannot be.
    """
    if os.environ.get("INTEROP") == "cached":
        check_ros_cache()
    else:
        build_ros(within_s=SHORT_BUILD_S if is_short else BUILD_S)


def build_ros(*, within_s: float = BUILD_S) -> None:
    """Install rclpy, and build the bridge, unless the cache has them.

    Raises:
        PeersMissing: There is no CPython 3.11, no cargo, or a build fails.
    """
    _install_wheels(within_s)
    _build_bridge(within_s)


def _install_wheels(within_s: float) -> None:
    wanted = find_ros_python()
    if wanted.exists():
        return
    python = sys.executable if sys.version_info[:2] == (3, 11) else shutil.which(PYTHON)
    if python is None:
        raise PeersMissing("no CPython 3.11 here, which the wheels of rclpy need")
    folder = wanted.parent.parent
    partial = folder.with_name(f"{folder.name}.{os.getpid()}")
    partial.parent.mkdir(parents=True, exist_ok=True)
    try:
        run_build((python, "-m", "venv", str(partial)), partial.parent, within_s)
        options = ("--quiet", "--no-deps", "--require-hashes", "--only-binary", ":all:")
        # The generators of messages need empy 3, which has no wheel.
        install = ("-m", "pip", "install", *options, "--no-binary", "empy", "-r", str(REQUIREMENTS))
        for arguments in (install, (str(MESSAGES),)):
            run_build((str(partial / "bin" / "python"), *arguments), partial, within_s)
        # An environment can be moved as long as its programs are started by its interpreter.
        partial.rename(folder)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def _build_bridge(within_s: float) -> None:
    built = find_bridge()
    if built.is_file():
        return
    cargo, package = find_cargo(), cache_folder() / "bridge"
    # Cargo recognizes a package by its path.
    shutil.rmtree(package, ignore_errors=True)
    shutil.copytree(SOURCES, package)
    target = cache_folder() / "target-bridge"
    command = (cargo, "build", "--release", "--target-dir", str(target))
    run_build(command, package, within_s, _find_libclang())
    keep_program(target / "release" / BINARY, built)


def _find_libclang() -> dict[str, str]:
    """Make the variables by which bindgen finds libclang and the headers of the compiler.

    Raises:
        PeersMissing: There is no C compiler.
    """
    found = next(find_ros_python().parent.parent.rglob("clang/native"), None)
    if found is None or shutil.which("gcc") is None:
        raise PeersMissing("no libclang or no gcc here, which the bridge needs")
    printed = subprocess.run(
        ["gcc", "-print-file-name=include"], capture_output=True, text=True, check=True
    )
    return {"LIBCLANG_PATH": str(found), "BINDGEN_EXTRA_CLANG_ARGS": f"-I{printed.stdout.strip()}"}

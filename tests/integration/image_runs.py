"""Images of `make image`, run with a read-only root as their user, without a daemon."""

import json
import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tests.contract.repository import ROOT
from tests.integration.processes import end

BUILDAH = ("sh", str(ROOT / ".ci" / "buildah"))
# Everything but two folders and the time-limited file systems of Linux is read-only.
RUN = """
root=$1 state=$2 user=$3
shift 3
mount --bind "$root" "$root"
mount --bind "$state" "$root/var/lib/zensim"
mount -t tmpfs -o mode=1777,size=64m tmpfs "$root/tmp"
mount -t proc proc "$root/proc"
mount --rbind /dev "$root/dev"
mount -o remount,bind,ro "$root"
exec chroot --userspec="$user" --groups= "$root" "$@"
"""


def run_buildah(*words: str) -> str:
    """Run buildah; return what it prints."""
    done = subprocess.run([*BUILDAH, *words], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


class MountedImage:
    """An image that is mounted, with its settings."""

    def __init__(self, target: str, container: str, root: Path) -> None:
        self.target, self.root = target, root
        settings = json.loads(run_buildah("inspect", "--type", "container", container))
        self.config: dict[str, Any] = settings["OCIv1"]["config"]

    def command(self, state: Path, *words: str) -> list[str]:
        """Make the command line that runs words in the image; it needs root."""
        variables = ["env", "-i", *self.config["Env"]]
        isolated = ["unshare", "--mount", "--pid", "--fork", "--kill-child"]
        places = [str(self.root), str(state), self.config["User"]]
        return [*isolated, "sh", "-ceu", RUN, "run", *places, *variables, *words]

    def run(self, state: Path, *words: str) -> "subprocess.CompletedProcess[str]":
        """Run words to their end."""
        return subprocess.run(
            self.command(state, *words), capture_output=True, text=True, check=False, timeout=300
        )

    @contextmanager
    def running(self, state: Path, *words: str) -> Iterator["subprocess.Popen[str]"]:
        """Run words in the background; end them afterwards."""
        process = subprocess.Popen(
            self.command(state, *words),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        try:
            yield process
        finally:
            end(process)


@contextmanager
def mounted(target: str) -> Iterator[MountedImage]:
    """Mount an image that `.ci/image` has built."""
    container = run_buildah("from", "--pull-never", f"localhost/zensim:{target}")
    try:
        yield MountedImage(target, container, Path(run_buildah("mount", container)))
    finally:
        run_buildah("rm", container)


def measure_mb(root: Path) -> float:
    """Measure the files of an image [MB]; links to one file count once."""
    seen: dict[tuple[int, int], int] = {}
    for folder, _, names in os.walk(root):
        for name in names:
            status = (Path(folder) / name).lstat()
            seen[status.st_dev, status.st_ino] = status.st_size
    return sum(seen.values()) * 1e-6

"""`python -m tests.hostile.coverage_fuzz READER [--seconds S]`: fuzz a parser, led by coverage.

libFuzzer keeps an input when it reaches code that no input reached before. The inputs are kept in
`tests/hostile/kept/READER.zip`, from which the next run starts, and which a test reads.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable, Iterable
from pathlib import Path

from benchmarks.machine import ROOT
from tests.hostile.corpus import corpus
from tests.hostile.fuzz import LONGEST_SEED, MESHES, make_mesh
from tests.hostile.sdf import sdf_cases
from tests.sim_server.description.sdf_robots import PIONEER
from zensim.proto.codec.message_codec import Format, MalformedPayload, encode, supports_format
from zensim.proto.codec.message_codec import decode as decode_message
from zensim.proto.sample_messages import make_sample_message
from zensim.proto.schema import list_top_level_types
from zensim.sim_server.description.builtin_models import read_builtin_model
from zensim.sim_server.description.meshes.mesh_reader import read_mesh
from zensim.sim_server.description.pipeline import read_robot
from zensim.sim_server.errors import SimError

KEPT = Path(__file__).with_name("kept")
RUNS_S = 600
MAX_BYTES = 4096
"""Limit of an input; longer ones reach no more code, only later."""
LONGEST_RUN_S = 10
MEMORY_MB = 2048
SCRIPT = """#!{python}
import sys, atheris
with atheris.instrument_imports(
    include=["zensim", "yourdfpy", "trimesh"], enable_loader_override=False
):
    from tests.hostile.coverage_fuzz import READERS
atheris.Setup(sys.argv, READERS["{reader}"])
atheris.Fuzz()
"""
"""Only modules that are imported after atheris can be instrumented; a merge runs its file again."""
KINDS = tuple(list_top_level_types())
FORMATS = tuple(Format)


def read_message(data: bytes) -> None:
    """Decode a message, whose type and format the first two bytes choose."""
    if len(data) < 2:
        return
    kind, format_ = KINDS[data[0] % len(KINDS)], FORMATS[data[1] % len(FORMATS)]
    try:
        message = decode_message(kind, data[2:], format_.value)
    except MalformedPayload:
        return
    if supports_format(kind, Format.MSGPACK):
        encode(message, Format.MSGPACK)


def read_description(data: bytes) -> None:
    """Read a robot description in URDF or SDF."""
    try:
        read_robot(data.decode("utf-8", "replace"), allow_missing=True)
    except SimError as refusal:
        if not str(refusal):
            raise AssertionError("a refusal without a text") from refusal


def read_mesh_file(data: bytes) -> None:
    """Read a mesh file, whose format the first byte chooses."""
    if not data:
        return
    try:
        read_mesh(f"a.{MESHES[data[0] % len(MESHES)]}", data[1:])
    except SimError:
        return


READERS: dict[str, Callable[[bytes], None]] = {
    "messages": read_message,
    "descriptions": read_description,
    "meshes": read_mesh_file,
}


def list_seeds(reader: str) -> list[bytes]:
    """List valid inputs from which a first run starts."""
    if reader == "messages":
        return [
            bytes((KINDS.index(kind) % 256, number)) + encode(make_sample_message(kind), format_)
            for kind in KINDS
            for number, format_ in enumerate(FORMATS)
            if supports_format(kind, format_)
        ]
    if reader == "meshes":
        return [bytes((number,)) + make_mesh(ending) for number, ending in enumerate(MESHES)]
    cases = [case.text for case in (*corpus(), *sdf_cases()) if len(case.text) < LONGEST_SEED]
    texts = (read_builtin_model("box_bot"), PIONEER, *cases)
    return [text.encode("utf-8", "replace") for text in texts]


def list_kept(reader: str, folder: Path = KEPT) -> list[bytes]:
    """List the inputs that earlier runs kept; none before the first."""
    path = folder / f"{reader}.zip"
    if not path.exists():
        return []
    with zipfile.ZipFile(path) as archive:
        return [archive.read(name) for name in archive.namelist()]


def main() -> None:
    """Fuzz one parser in a child process, then keep the inputs that reach the most."""
    parser = argparse.ArgumentParser(prog="python -m tests.hostile.coverage_fuzz")
    parser.add_argument("reader", choices=sorted(READERS))
    parser.add_argument("--seconds", type=int, default=RUNS_S)
    parser.add_argument("--kept", type=Path, default=KEPT, help="folder of the inputs")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="zensim-fuzz-") as folder:
        script, grown, kept = (Path(folder) / name for name in ("fuzz.py", "grown", "kept"))
        script.write_text(SCRIPT.format(python=sys.executable, reader=given.reader))
        script.chmod(0o700)
        _write_files(grown, [*list_seeds(given.reader), *list_kept(given.reader, given.kept)])
        kept.mkdir()
        _run(script, f"-max_total_time={given.seconds}", "-print_final_stats=1", str(grown))
        _run(script, "-merge=1", str(kept), str(grown))
        inputs = sorted(path.read_bytes() for path in kept.iterdir())
    _keep(given.kept / f"{given.reader}.zip", inputs)
    print(f"{given.reader}: no crash in {given.seconds} s; {len(inputs)} inputs kept")  # noqa: T201


def _write_files(folder: Path, inputs: Iterable[bytes]) -> None:
    folder.mkdir()
    for number, data in enumerate(inputs):
        (folder / f"{number:06}").write_bytes(data[:MAX_BYTES])


def _run(script: Path, *options: str) -> None:
    limits = (f"-max_len={MAX_BYTES}", f"-timeout={LONGEST_RUN_S}", f"-rss_limit_mb={MEMORY_MB}")
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    subprocess.run([str(script), *limits, *options], env=environment, check=True)


def _keep(path: Path, inputs: list[bytes]) -> None:
    path.parent.mkdir(exist_ok=True)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for number, data in enumerate(inputs):
            # A fixed date: equal inputs make an equal file.
            archive.writestr(zipfile.ZipInfo(f"{number:06}"), data, zipfile.ZIP_DEFLATED)


if __name__ == "__main__":
    main()

"""Build tf2_msgs/msg/TFMessage, which has no wheel, into the environment that runs this.

The generators of rosidl write sources, gcc compiles them to one library. Nothing of zensim is
imported.
"""

import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path

PREFIX, PACKAGE = Path(sys.prefix), "tf2_msgs"
os.environ["AMENT_PREFIX_PATH"] = sys.prefix

import numpy  # noqa: E402  after the variable
from rosidl_adapter.msg import convert_msg_to_idl  # noqa: E402
from rosidl_generator_c.cli import GenerateC  # noqa: E402
from rosidl_generator_py.cli import GeneratePython  # noqa: E402
from rosidl_generator_type_description.cli import HashTypeDescription  # noqa: E402
from rosidl_typesupport_c.cli import GenerateCTypesupport  # noqa: E402
from rosidl_typesupport_fastrtps_c.cli import GenerateFastRTPSCTypesupport  # noqa: E402
from rosidl_typesupport_introspection_c.cli import GenerateIntrospectionCTypesupport  # noqa: E402

SUPPORTS = ("rosidl_typesupport_fastrtps_c", "rosidl_typesupport_introspection_c")
LIBRARIES = (
    *(f"geometry_msgs__{one}" for one in ("rosidl_generator_py", "rosidl_generator_c", *SUPPORTS)),
    *("std_msgs__rosidl_generator_c", "builtin_interfaces__rosidl_generator_c"),
    *("rosidl_runtime_c", "rosidl_typesupport_c", "rosidl_typesupport_fastrtps_cpp", *SUPPORTS),
    *("fastcdr", "rmw", "rcutils", "stdc++"),
)


def generate(folder: Path) -> list[Path]:
    """Write the sources; return their folders, that of the package first."""
    definition, own = folder / "msg" / "TFMessage.msg", folder / "own" / PACKAGE
    definition.parent.mkdir()
    definition.write_text("geometry_msgs/TransformStamped[] transforms\n", encoding="utf-8")
    convert_msg_to_idl(folder, PACKAGE, Path("msg/TFMessage.msg"), definition.parent)
    what = (PACKAGE, [f"{folder}:msg/TFMessage.idl"], [str(PREFIX / "share")])
    hashes = HashTypeDescription("").generate_type_hashes(*what, own)
    GenerateC("").generate(*what, own, type_description_files=list(map(str, hashes)))
    GenerateFastRTPSCTypesupport("").generate(*what, own)
    GenerateCTypesupport("", typesupport_implementations=list(SUPPORTS)).generate(*what, own)
    python = GeneratePython("", typesupport_implementations=["rosidl_typesupport_c"])
    python.generate(*what, own)
    (own / "__init__.py").touch()
    # Its files have names of others.
    inspected = folder / "introspection" / PACKAGE
    GenerateIntrospectionCTypesupport("").generate(*what, inspected)
    return [own, inspected]


def compile_all(folders: list[Path], library: Path) -> None:
    """Compile the sources."""
    paths = (Path(sysconfig.get_path("include")), Path(numpy.get_include()), PREFIX / "include")
    included = (*(one.parent for one in folders), *paths, *paths[-1].iterdir())
    sources = [
        one for folder in folders for kind in ("c", "cpp") for one in folder.rglob(f"*.{kind}")
    ]
    options = ("-shared", "-fPIC", "-w", *(f"-I{one}" for one in included))
    linked = (f"-L{PREFIX / 'lib'}", *(f"-l{one}" for one in LIBRARIES))
    command = ("gcc", *options, *map(str, sources), "-o", str(library), *linked)
    subprocess.run(command, check=True)


def main() -> None:
    """Build the package and install it."""
    packages = Path(sysconfig.get_path("purelib"))
    with tempfile.TemporaryDirectory() as scratch:
        folders = generate(Path(scratch))
        name = f"{PACKAGE}_s__rosidl_typesupport_c.so"
        compile_all(folders, folders[0] / name)
        shutil.move(folders[0], packages / PACKAGE)
    for one in SUPPORTS:
        target = os.path.relpath(packages / PACKAGE / name, PREFIX / "lib")
        (PREFIX / "lib" / f"lib{PACKAGE}__{one}.so").symlink_to(target)


if __name__ == "__main__":
    main()

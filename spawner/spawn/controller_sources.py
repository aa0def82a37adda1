"""Controllers' files of a robot: given, named by its plug-ins, or the only fitting one.

A description may be untrusted: only YAML files in the search paths are read.
"""

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from pathlib import Path

import msgspec

from zensim.proto.bounded_files import read_text_file
from zensim.proto.messages.model_messages import ReportEntry
from zensim.spawner.spawn.description_xml import DescriptionError, parse_description
from zensim.spawner.spawn.search_paths import (
    SearchPaths,
    is_package,
    list_folders,
    read_manifest,
    to_package_uris,
)

YAML_SUFFIXES = (".yaml", ".yml")
MAX_CONTROLLERS_BYTES = 1 << 18
MAX_SCANNED_FILES = 1000
CONTROL_PLUGIN = "ros2_control"
INSTALLED = "share"
DRIVE_TYPE = re.compile(
    r"\b(?:diff_drive_controller/Diff|mecanum_drive_controller/Mecanum"
    r"|omni_wheel_drive_controller/Omni|tricycle_controller/Tricycle"
    r"|\w+_steering_controller/\w+Steering)\w*Controller\b"
)
DRIVE_FILE = re.compile(
    r"drive|ackermann|planar_move|mecanum|velocity-control|kobuki|_create\b", re.IGNORECASE
)
"""File name of a plug-in that drives a robot."""
WORD = re.compile(r"[\w./-]+")
LAUNCH_ARGUMENT = "$(arg "
MIN_ENDING = 5
"""Characters of a name without the prefix that an argument of a launch file gives."""
MIN_JOINTS = 2
"""A file fits if it names so many joints of the robot."""


class ControllerTexts(msgspec.Struct, frozen=True):
    """Texts of controllers' files, and notes on where they are from."""

    texts: tuple[str, ...] = ()
    notes: tuple[ReportEntry, ...] = ()


def read_controller_files(files: Sequence[Path]) -> ControllerTexts:
    """Read the files that a user gives.

    Raises:
        OSError: A file cannot be read, or is too large.
        ValueError: A file is not text.
    """
    return ControllerTexts(tuple(_read_text(file) for file in files))


def _read_text(file: Path) -> str:
    return read_text_file(file, MAX_CONTROLLERS_BYTES)


def find_controller_files(text: str, paths: SearchPaths) -> ControllerTexts:
    """Find the files that plug-ins name; else the only fitting one, if no plug-in drives.

    Args:
        text: Description with expanded xacro.
        paths: With the folder of the description.
    """
    try:
        robot = parse_description(text)
    except DescriptionError:
        return ControllerTexts()
    if named := list(_list_parameters(robot)):
        return _read_named(named, paths)
    drives = any(DRIVE_FILE.search(one.get("filename", "")) for one in robot.iter("plugin"))
    return ControllerTexts() if drives else _find_fitting(robot, paths)


def _list_parameters(robot: ET.Element) -> Iterator[str]:
    for plugin in robot.iter("plugin"):
        if CONTROL_PLUGIN in plugin.get("filename", ""):
            for tag in plugin.findall("parameters"):
                yield (tag.text or "").strip()


def _read_named(named: Sequence[str], paths: SearchPaths) -> ControllerTexts:
    texts, notes = [], []
    for name in dict.fromkeys(named):
        found, fault = _read_one(name, paths)
        if found is None:
            reason = f"a plug-in names {name[:160]!r}: {fault}; or give --controllers FILE"
            notes.append(ReportEntry("suspicious", "controllers", reason))
        else:
            texts.append(found[1])
            notes.append(ReportEntry("applied", "controllers", f"{found[0]}, as a plug-in names"))
    return ControllerTexts(tuple(texts), tuple(notes))


def _read_one(name: str, paths: SearchPaths) -> tuple[tuple[Path, str] | None, str]:
    if not name.lower().endswith(YAML_SUFFIXES):
        return None, "not a YAML file"
    fault = ""
    for uri in _list_uris(name):
        location = paths.find(uri)
        fault = fault or location.reason
        if location.path is None or location.path.suffix.lower() not in YAML_SUFFIXES:
            continue
        try:
            return (location.path, _read_text(location.path)), ""
        except (OSError, ValueError) as error:
            fault = str(error)
    return None, fault


def _list_uris(name: str) -> Iterator[str]:
    """List the URIs that a name may mean: files of another host are found by their package."""
    uri = to_package_uris(name)
    yield uri
    if uri.startswith("/"):
        parts = Path(uri).parts
        for at in range(len(parts) - 2, 0, -1):
            yield f"package://{'/'.join(parts[at:])}"


def _find_fitting(robot: ET.Element, paths: SearchPaths) -> ControllerTexts:
    joints = {joint.get("name", "") for joint in robot.iter("joint")}
    fitting = [file for file in _list_yaml_files(paths) if _fits(file, joints)]
    related = [file for file in fitting if _is_related(file, paths)]
    own = [file for file in fitting if file.parent == paths.folder]
    for files, why in ((related, "the only file here"), (own, "the only file beside it")):
        if len(files) == 1:
            note = ReportEntry("applied", "controllers", f"{files[0]}, {why} that names its wheels")
            return ControllerTexts((_read_text(files[0]),), (note,))
    notes = [
        ReportEntry("ignored", "controllers", f"{file} fits, too; choose by --controllers FILE")
        for file in fitting
    ]
    return ControllerTexts((), tuple(notes))


def _is_related(file: Path, paths: SearchPaths) -> bool:
    """Whether a file is of this robot: beside it, or of a package named alike or naming its own."""
    own = [folder for folder in paths.own_folders if is_package(folder)]
    package = next(filter(is_package, file.parents), None)
    beside = [folder.parent for folder in own if folder.parent.name != INSTALLED]
    if not own or package is None or any(file.is_relative_to(folder) for folder in beside):
        return True
    word, manifest = package.name.partition("_")[0], read_manifest(package)
    return any(word == one.name.partition("_")[0] or one.name in manifest for one in own)


def _list_yaml_files(paths: SearchPaths) -> Iterator[Path]:
    """List YAML files of the packages of the description, beside it and in search paths."""
    seen = 0
    for package in _list_packages(paths):
        for file in sorted(package.rglob("*")):
            if file.suffix.lower() not in YAML_SUFFIXES or file.is_symlink():
                continue
            seen += 1
            if seen > MAX_SCANNED_FILES:
                return
            yield file


def _list_packages(paths: SearchPaths) -> list[Path]:
    own = [folder for folder in paths.own_folders if is_package(folder)]
    beside = [child for folder in own for child in list_folders(folder.parent)]
    given = [*paths.roots, *(child for root in paths.roots for child in list_folders(root))]
    given += [child for folder in given for child in list_folders(folder)]
    return list(dict.fromkeys((*own, *filter(is_package, (*beside, *given)))))


def _fits(file: Path, joints: set[str]) -> bool:
    try:
        text = _read_text(file)
    except (OSError, ValueError):
        return False
    if not DRIVE_TYPE.search(text):
        return False
    words = set(WORD.findall(text))
    named = joints & words
    if not named and LAUNCH_ARGUMENT in text:
        endings = tuple(f"_{word}" for word in words if len(word) >= MIN_ENDING)
        named = {joint for joint in joints if joint.endswith(endings)}
    return len(named) >= MIN_JOINTS

"""Errors with which the server refuses requests: one root class, one class per kind."""

from zensim.proto.messages.result_messages import ResultCode, SpawnCode
from zensim.proto.printable_text import printable


class SimError(Exception):
    """A request is refused; the dispatcher makes a Result of it.

    `slug` identifies the error for programs, such as `urdf.cycle`, and starts the message;
    docs/refusals.md lists all slugs. Empty where the result code is sufficient.
    """

    code: int = ResultCode.OPERATION_FAILED
    slug = ""

    def __init__(self, message: str) -> None:
        message = printable(message)  # messages quote input, which may be anything
        self.fault = message
        self.message = f"{self.slug}: {message}" if self.slug else message
        super().__init__(self.message)


class ModelError(SimError):
    """A robot or world description cannot be used."""

    def __init__(
        self, message: str, *, code: int = SpawnCode.RESOURCE_PARSE_ERROR, slug: str
    ) -> None:
        self.slug = slug
        super().__init__(message)
        self.code = code


class EntityNotFound(SimError):
    """No entity has this name."""

    code = ResultCode.NOT_FOUND

    def __init__(self, name: str) -> None:
        super().__init__(f"entity {name[:80]!r} does not exist; 'get_entities' lists those that do")


class NameNotUnique(SimError):
    """Two entities would have the same name."""

    code = SpawnCode.NAME_NOT_UNIQUE
    slug = "name.taken"

    def __init__(self, name: str) -> None:
        super().__init__(
            f"entity '{name}' already exists; choose another name or set allow_renaming"
        )


class NameRefused(SimError):
    """The name is not valid."""

    code = SpawnCode.NAME_INVALID
    slug = "name.invalid"


class NamespaceRefused(SimError):
    """The namespace is not valid, or belongs to another entity."""

    code = SpawnCode.NAMESPACE_INVALID
    slug = "name.namespace"


class PoseRefused(SimError):
    """The pose or twist is not finite or out of range."""

    code = SpawnCode.INVALID_POSE
    slug = "pose.refused"


class IncorrectState(SimError):
    """The request is not possible in the current state."""

    code = ResultCode.INCORRECT_STATE


class SteppedByOther(SimError):
    """Another client steps the simulation."""

    code = ResultCode.INCORRECT_STATE
    slug = "stepped_elsewhere"

    def __init__(self, holder: str) -> None:
        super().__init__(f"client '{holder[:80]}' steps the simulation; wait until it has ended")


class UnsupportedFeature(SimError):
    """The server does not have this feature of simulation_interfaces."""

    code = ResultCode.FEATURE_UNSUPPORTED


class AssetRefused(SimError):
    """A file cannot be stored or read."""

    def __init__(self, message: str, *, slug: str, code: int = ResultCode.OPERATION_FAILED) -> None:
        self.slug = slug
        super().__init__(message)
        self.code = code


class RequestRefused(SimError):
    """Any other refusal, with a result code of the service."""

    def __init__(self, code: int, message: str) -> None:
        super().__init__(message)
        self.code = code

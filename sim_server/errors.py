"""Refusals of the server: one root exception, one class for each kind."""

from zensim.proto.messages.result_messages import ResultCode, SpawnCode


class SimError(Exception):
    """A request is refused; turned into a Result in one place.

    `slug` names the fault for programs, such as `urdf.cycle`, and begins the message, whose rest
    is for people; docs/refusals.md lists all slugs. Empty where the result's code says it all.
    """

    code: int = ResultCode.OPERATION_FAILED
    slug = ""

    def __init__(self, message: str) -> None:
        if not message.isprintable():  # what was given is quoted, and may be anything
            message = "".join(letter if letter.isprintable() else "?" for letter in message)
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
    """A name that is not one."""

    code = SpawnCode.NAME_INVALID
    slug = "name.invalid"


class NamespaceRefused(SimError):
    """A namespace that is not one, or that another entity has."""

    code = SpawnCode.NAMESPACE_INVALID
    slug = "name.namespace"


class PoseRefused(SimError):
    """A pose or twist that no entity can have."""

    code = SpawnCode.INVALID_POSE
    slug = "pose.refused"


class IncorrectState(SimError):
    """Right request, wrong moment."""

    code = ResultCode.INCORRECT_STATE


class UnsupportedFeature(SimError):
    """A feature of the vocabulary that this server does not have."""

    code = ResultCode.FEATURE_UNSUPPORTED


class AssetRefused(SimError):
    """A file that was sent or asked for."""

    def __init__(self, message: str, *, slug: str, code: int = ResultCode.OPERATION_FAILED) -> None:
        self.slug = slug
        super().__init__(message)
        self.code = code


class RequestRefused(SimError):
    """Any other refusal, with the code of its service."""

    def __init__(self, code: int, message: str) -> None:
        super().__init__(message)
        self.code = code

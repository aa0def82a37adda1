"""Errors that vehicles report, with the names and levels of each version of the standard."""

from typing import Final, NamedTuple, TypeAlias

import msgspec

from zensim.vda5050.vda_messages import Major

References: TypeAlias = tuple[tuple[str, str], ...]


class ErrorKind(NamedTuple):
    """One kind of error: type and level of 2.1, then of 3.0."""

    type_2: str
    level_2: str
    type_3: str
    level_3: str

    def name(self, major: Major) -> str:
        """Return its type."""
        return self.type_3 if major == 3 else self.type_2  # noqa: PLR2004

    def level(self, major: Major) -> str:
        """Return its level."""
        return self.level_3 if major == 3 else self.level_2  # noqa: PLR2004


INVALID: Final = ErrorKind("validationError", "WARNING", "VALIDATION_FAILURE", "WARNING")
UNKNOWN_ACTION: Final = ErrorKind("orderError", "WARNING", "INVALID_ORDER_ACTION", "WARNING")
OUTDATED: Final = ErrorKind("orderUpdateError", "WARNING", "OUTDATED_ORDER_UPDATE", "WARNING")
SAME_ID: Final = ErrorKind("orderUpdateError", "WARNING", "SAME_ORDER_UPDATE_ID", "WARNING")
AFTER_CANCEL: Final = ErrorKind(
    "orderUpdateError", "WARNING", "ORDER_UPDATE_FOLLOWING_CANCEL", "WARNING"
)
BUSY: Final = ErrorKind("orderUpdateError", "WARNING", "OTHER_ORDER_ACTIVE", "WARNING")
START_TOO_FAR: Final = ErrorKind("noRouteError", "WARNING", "START_NODE_OUT_OF_RANGE", "WARNING")
NO_ROUTE: Final = ErrorKind("noRouteError", "WARNING", "NO_ROUTE_TO_TARGET", "WARNING")
UNKNOWN_MAP: Final = ErrorKind("orderError", "WARNING", "UNKNOWN_MAP_ID", "WARNING")
NO_ORDER_TO_CANCEL: Final = ErrorKind("noOrderToCancel", "WARNING", "NO_ORDER_TO_CANCEL", "WARNING")
INSTANT_ACTION: Final = ErrorKind(
    "instantActionError", "WARNING", "INVALID_INSTANT_ACTION", "WARNING"
)
OFF_ROUTE: Final = ErrorKind("outOfRoute", "FATAL", "NODE_UNREACHABLE", "CRITICAL")
NO_PROGRESS: Final = ErrorKind("noProgress", "WARNING", "NO_PROGRESS", "WARNING")
ACTION_FAILED: Final = ErrorKind("actionError", "WARNING", "ACTION_FAILED", "CRITICAL")
LOW_BATTERY: Final = ErrorKind("lowBattery", "WARNING", "LOW_BATTERY", "URGENT")
EMPTY_BATTERY: Final = ErrorKind("emptyBattery", "FATAL", "EMPTY_BATTERY", "FATAL")
LOST: Final = ErrorKind("localizationError", "FATAL", "LOCALIZATION_ERROR", "FATAL")


class VehicleError(msgspec.Struct, frozen=True):
    """An error of a vehicle."""

    kind: ErrorKind
    text: str
    references: References = ()


class Rejection(Exception):
    """A vehicle does not accept an order."""

    def __init__(self, kind: ErrorKind, text: str) -> None:
        super().__init__(text)
        self.kind = kind

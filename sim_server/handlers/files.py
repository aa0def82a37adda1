"""Files that descriptions speak of: which are missing, in and out, piece by piece."""

from zensim.proto import assets
from zensim.proto.result import Result
from zensim.sim_server.desk import Desk


def missing_assets(
    desk: Desk, request: assets.MissingAssetsRequest
) -> assets.MissingAssetsResponse:
    """Tell which files are not here yet."""
    missing = desk.store.missing(request.sha256s)
    return assets.MissingAssetsResponse(
        Result(), tuple(name for name, _ in missing), tuple(received for _, received in missing)
    )


def put_asset(desk: Desk, request: assets.PutAssetRequest) -> assets.PutAssetResponse:
    """Take a piece of a file."""
    received = desk.store.put(
        request.sha256, offset=request.offset, total=request.total, data=request.data
    )
    return assets.PutAssetResponse(Result(), received)


def get_asset(desk: Desk, request: assets.GetAssetRequest) -> assets.GetAssetResponse:
    """Give a piece of a file."""
    data = desk.store.piece(request.sha256, request.offset, assets.MAX_CHUNK_BYTES)
    return assets.GetAssetResponse(Result(), data, desk.store.size(request.sha256))

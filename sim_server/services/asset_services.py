"""Services that transfer mesh files in pieces."""

from zensim.proto.messages import asset_messages
from zensim.proto.messages.result_messages import Result
from zensim.sim_server.parser_process.asset_store import AssetStore


def missing_assets(
    store: AssetStore, request: asset_messages.MissingAssetsRequest
) -> asset_messages.MissingAssetsResponse:
    """List the files that the server does not have."""
    missing = store.missing(request.sha256s)
    return asset_messages.MissingAssetsResponse(
        Result(), tuple(name for name, _ in missing), tuple(received for _, received in missing)
    )


def put_asset(
    store: AssetStore, request: asset_messages.PutAssetRequest
) -> asset_messages.PutAssetResponse:
    """Store a piece of a file."""
    received = store.put(
        request.sha256, offset=request.offset, total=request.total, data=request.data
    )
    return asset_messages.PutAssetResponse(Result(), received)


def get_asset(
    store: AssetStore, request: asset_messages.GetAssetRequest
) -> asset_messages.GetAssetResponse:
    """Return a piece of a file."""
    data = store.read(request.sha256, request.offset, asset_messages.MAX_CHUNK_BYTES)
    return asset_messages.GetAssetResponse(Result(), data, store.size(request.sha256))

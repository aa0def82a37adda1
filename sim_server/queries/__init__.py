"""Read-only queries on a world: filters, bounds, frames and scoped names."""

"""Messages on the wire, as msgspec structs."""

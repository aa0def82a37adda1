"""Message serialization: CDR, MessagePack and JSON."""

"""Robots of a world as vehicles of VDA 5050: an MQTT interface for fleet managers."""

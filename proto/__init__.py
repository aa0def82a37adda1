"""The wire: messages, codecs, keys, catalogs of services and topics, and ROS 2 endpoints."""

"""ROS 2 as rmw_zenoh and zenoh-bridge-ros2dds speak it over Zenoh: keys, hashes, tokens. Pure."""

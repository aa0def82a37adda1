"""The ROS 2 wire protocol over Zenoh, as rmw_zenoh and zenoh-bridge-ros2dds use it."""

"""Many robots in one simulated world, on a Zenoh network, without ROS or Gazebo."""

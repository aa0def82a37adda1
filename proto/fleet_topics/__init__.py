"""One topic of many robots on plain and ROS 2 keys; publishers are declared lazily."""

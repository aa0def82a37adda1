"""The ROS 2 node of the server: services, topics and the SimulateSteps action."""

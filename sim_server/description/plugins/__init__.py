"""Gazebo plug-ins of models: drives, publishers and sensors."""

"""Robot and world descriptions: URDF and SDF in, Model out."""

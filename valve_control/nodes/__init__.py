"""Thin ROS 2 adapters around laws and valve; the only room that imports ROS."""

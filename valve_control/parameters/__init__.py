"""Lists every parameter with type, default, range and unit, and builds laws and valve from values. No ROS."""

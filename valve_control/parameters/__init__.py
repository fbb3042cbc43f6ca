"""Every parameter with type, default, range, unit and text; what is built from them. No ROS."""

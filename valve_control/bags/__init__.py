"""Bags of rosbag2: written, mended, and read column by column, without ROS."""

"""Reads, writes and repairs rosbag2 bags (ROS 2 recordings) without needing ROS."""

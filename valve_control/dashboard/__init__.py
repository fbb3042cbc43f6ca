"""Shows valves in the browser, and lets one tune, compare and undo; knows no ROS."""

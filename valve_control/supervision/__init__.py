"""What stands between a law and a machine: believable readings, timeouts, takeover, faults; no ROS."""

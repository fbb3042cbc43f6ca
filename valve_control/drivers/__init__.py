"""Drivers of amplifier and LVDT: signals in the device's own unit, in and out; no ROS."""

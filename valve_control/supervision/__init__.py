"""Keeps a law safe on a machine: rejects bad readings, bridges gaps, switches off, swaps laws. No ROS."""

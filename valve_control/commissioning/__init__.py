"""Commissions a running valve: tests within limits, model, gains, verification; knows no ROS."""

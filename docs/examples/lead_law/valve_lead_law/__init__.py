"""A law of another package for valve_control."""

"""Simulates closed loops: one run, batches of many valves, and studies of robustness."""

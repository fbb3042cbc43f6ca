"""Simulates whole axes: upper level, valve controller, valve, cylinder and load; one run, or many."""

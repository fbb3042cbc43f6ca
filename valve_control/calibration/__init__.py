"""Searches for a simulated valve on which the controllers give a measured table of indices."""

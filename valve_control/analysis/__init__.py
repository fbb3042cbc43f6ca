"""Indices, frequency response and figures."""

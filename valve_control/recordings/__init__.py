"""Runs out of bags: valves, parameters, aligned signals; analysed, compared and replayed."""

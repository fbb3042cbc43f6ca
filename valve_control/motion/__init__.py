"""Moves an axis: courses to follow, and the upper levels that command the spool, as pure steps on numbers."""

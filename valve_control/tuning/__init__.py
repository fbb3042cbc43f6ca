"""Finds the gains of any law for a box of valves: margins of the sampled loop, search, verification."""

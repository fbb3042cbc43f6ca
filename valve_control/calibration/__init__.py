"""A simulated valve whose controllers give a measured table of performance indices."""

"""Command shapes, the compiled closed loop, and offline runs."""

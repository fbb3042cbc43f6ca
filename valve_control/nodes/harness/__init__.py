"""Tools that start the nodes as processes, disturb and measure them; no node imports anything from here."""

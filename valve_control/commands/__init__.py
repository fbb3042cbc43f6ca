"""Makes the commands of an upper level: shapes over time, or numbers from a file."""
